#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sfm_split/pictures/picture_comparison.h"

namespace s2gs {

/// A picture's brightness between its pixels, smoothed.
class EdgePicture {
 public:
  explicit EdgePicture(const GreyPicture& picture);

  int width() const { return width_; }
  int height() const { return height_; }
  /// Pixels of the photo per pixel.
  const Eigen::Vector2d& scale() const { return scale_; }

  /// Whether a place [px, from the corner] and what lies within two pixels of it is in the picture.
  bool Contains(const Eigen::Vector2d& xy) const {
    return xy.x() >= 2.5 && xy.y() >= 2.5 && xy.x() <= width_ - 2.5 && xy.y() <= height_ - 2.5;
  }
  /// Of a place that it contains.
  float BrightnessAt(const Eigen::Vector2d& xy) const;

  /// A pixel whose slope is steeper than those beside it across the edge, and than most of the picture's.
  struct Edge {
    Eigen::Vector2d xy;      ///< [px, from the corner]
    Eigen::Vector2d normal;  ///< across the edge.
  };
  std::vector<Edge> Edges() const;

 private:
  int width_;
  int height_;
  Eigen::Vector2d scale_;
  std::vector<float> brightness_;
};

/// Which directions edges have near a place of a pinhole camera's picture, in cells of some pixels.
class EdgeDirections {
 public:
  static constexpr int kDirections = 8;  ///< of half a turn

  /// \param focal_px  of cells. \param reach  of the picture on either side of its middle [cells].
  EdgeDirections(double focal_px, const Eigen::Vector2i& reach);

  double focal_px() const { return focal_px_; }
  /// \param xy  from the picture's middle [cells]. \param normal  across the edge.
  void Add(const Eigen::Vector2d& xy, const Eigen::Vector2d& normal);
  /// Once all are added: an edge is near its own cell and those next to it.
  void Spread();

  bool Contains(const Eigen::Vector2d& xy) const {
    return std::abs(xy.x()) < reach_.x() && std::abs(xy.y()) < reach_.y();
  }
  /// Whether an edge across `normal` is near a place that it contains.
  bool HasEdge(const Eigen::Vector2d& xy, const Eigen::Vector2d& normal) const {
    return (masks_[CellOf(xy)] >> DirectionOf(normal) & 1U) != 0;
  }
  /// How often one is, of all cells and directions.
  double Share() const;

 private:
  size_t CellOf(const Eigen::Vector2d& xy) const {
    return static_cast<size_t>(xy.y() + reach_.y()) * width_ + static_cast<size_t>(xy.x() + reach_.x());
  }
  static int DirectionOf(const Eigen::Vector2d& normal);

  double focal_px_;
  Eigen::Vector2i reach_;
  size_t width_;
  std::vector<uint8_t> masks_;  // a bit for each direction
};

}  // namespace s2gs
