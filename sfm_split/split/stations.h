#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/features.h"

namespace s2gs {

struct StationOptions {
  /// A match that moves by no more than this, after the pair's common shift is taken off, is unmoved [px].
  double max_unmoved_px = 1.5;
  /// Largest common shift between two images of one station: shake of the tripod [px].
  double max_shake_px = 12;
  /// Fewest unmoved matches that join two images.
  int min_unmoved_matches = 30;
  /// Smallest share of a pair's matches that are unmoved.
  double min_unmoved_share = 0.1;
  /// Unmoved matches must lie in at least this many cells of a grid of 8 x 8 over the image. Dust and a
  /// watermark fill few.
  int min_cells = 6;

  OptionCheck Check() const;
  /// With bounds in pixels of photos of that size; the defaults are for photos of up to 1600 pixels.
  StationOptions ForPhotosOf(int longest_side_px) const;
};

/// What is unmoved between two images.
struct UnmovedMatches {
  Eigen::Vector2f shift = Eigen::Vector2f::Zero();  ///< common shift from image1 to image2 [px].
  std::vector<bool> is_unmoved;                     ///< per match.
  int num_unmoved = 0;
  int num_cells = 0;          ///< occupied cells of the 8 x 8 grid.
  bool same_station = false;  ///< by the options' bounds.
};

/// Finds the common shift of a pair (the mode of the displacements within max_shake_px) and the matches that
/// follow it. \param image_size  width and height [px].
UnmovedMatches FindUnmovedMatches(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                  const ImagePairMatches& pair, const Eigen::Vector2i& image_size,
                                  const StationOptions& options);

/// Images grouped by camera position.
struct Stations {
  std::vector<int> station_of_image;     ///< per image, numbered in the order of first images.
  std::vector<std::vector<int>> images;  ///< per station, ascending.
  std::vector<Eigen::Vector2f> shift;    ///< per image: shake relative to the station's first image [px].
  /// Per image, where it was measured: where it shows a background pixel of the station's first image. Empty:
  /// nothing but `shift` is known.
  std::vector<Eigen::Matrix3d> photo_from_first;

  /// Where the image shows a background pixel of its station's first image [px]: the identity where the
  /// camera did not move, and where it was not measured, for features tell no shift of less than a pixel.
  Eigen::Matrix3d PhotoFromFirst(int image) const;

  /// Where image `to` shows what stands still and lies at `xy` in image `from` of the same station [px].
  Eigen::Vector2f Move(int from, int to, const Eigen::Vector2f& xy) const;
};

/// Two images whose features say that the camera stood still.
struct StationJoin {
  int image1 = 0;
  int image2 = 0;
  int num_unmoved = 0;
  Eigen::Vector2f shift = Eigen::Vector2f::Zero();  ///< from image1 to image2 [px].
};

/// The pairs of images that see the same unmoved background, strongest first. Every pair in `pairs` is
/// judged; pairs that were not matched say nothing.
std::vector<StationJoin> FindStationJoins(const std::vector<Keypoints>& keypoints,
                                          const std::vector<Eigen::Vector2i>& image_sizes,
                                          const std::vector<ImagePairMatches>& pairs,
                                          const StationOptions& options);

/// Groups images by their joins, strongest first. A chain of small steps that adds up to more than
/// max_shake_px is a moving camera, not a station: the weakest joins are then left out.
Stations GroupJoined(size_t num_images, const std::vector<StationJoin>& joins, const StationOptions& options);

}  // namespace s2gs
