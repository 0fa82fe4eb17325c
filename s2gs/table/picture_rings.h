#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "s2gs/core/pinhole_view.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// What a camera that stands still sees while the table turns, in the world's frame: what looks the same in
/// most of its photos, as a plain table does.
struct StillPicture {
  PinholeView view;  ///< of the image's size.
  Image8 image;      ///< RGB
};

/// What an edge is looked for in: the most different of a colour's channels, and its tint alone (red against
/// green, both against blue). Shading and shadows change light more than tint, so that a rim before ground of
/// another tint is clearer in it.
constexpr int kColorWays = 3;
using ColorChange = std::array<float, kColorWays>;  ///< of colour, in grey values.

/// Within which of another one edge alone counts, the clearest.
constexpr double kEdgeApartPx = 2.5;

/// A straight line on a surface in the world, from `start` in equal steps.
struct SurfaceLine {
  Eigen::Vector3d start;
  Eigen::Vector3d step;
};
/// The lines of one direction's arc. What a direction shows is their mean: an edge along the arc is in all of
/// it, and grain is not.
constexpr int kLinesOfArc = 5;
using ArcLines = std::array<SurfaceLine, kLinesOfArc>;

/// What an arc's lines show of a surface. Keeps a reference to the picture.
class SeenArc {
 public:
  SeenArc(const StillPicture& picture, const ArcLines& lines);

  /// The change of colour across a place of the lines.
  struct Crossing {
    ColorChange change = {};
    double pitch = 0;  ///< [px] of a step.
  };
  /// \param s  [steps]. Nothing where less than half of the arc is in the picture.
  std::optional<Crossing> At(double s) const;

 private:
  // A line as a picture shows it.
  struct SeenLine {
    Eigen::Vector3d start, step;  // in the camera
  };
  struct Place {
    Eigen::Vector2d pixel;
    Eigen::Vector2d step;  // [px] that one more moves it
  };
  std::optional<Place> PlaceOn(const SeenLine& line, double s) const;

  const StillPicture& picture_;
  std::array<SeenLine, kLinesOfArc> lines_;
};

/// What counts as an edge.
struct EdgeKind {
  int num_ways = kColorWays;  ///< in which it is looked for, the first: in the first alone by light.
  /// It is more than the surface just within the ring changes about its line; else about all lines, since of
  /// ground of many colours only the clearest edges are rare.
  bool is_local = false;
};

/// What a picture shows along lines that lead across circles about an axis, one step on each line a circle.
class PictureRings {
 public:
  PictureRings(const StillPicture& picture, const std::vector<ArcLines>& lines, int num_steps);

  /// The steps that lines have to have for so many rings to be looked at, and what lies beyond them.
  static int NumSteps(int num_rings);

  /// The lines on which a step is seen, and those of them on which there is an edge next to it.
  struct Ring {
    int seen = 0;
    int edges = 0;
  };
  Ring At(int s, const EdgeKind& kind) const;
  /// The same on one line.
  Ring OfLine(size_t line, int s, const EdgeKind& kind) const;

  /// What is more than the changes of the surface just within a ring. \param line  about which, if it is
  /// local.
  ColorChange Threshold(size_t line, int s, const EdgeKind& kind) const;

  /// The first edge on each line, in the first so many ways, from step `first` on; the number of steps where
  /// there is none.
  std::vector<int> FirstEdges(int first, const ColorChange& thresholds, int num_ways) const;

  /// That there is an edge of this ring's kind, from what lies beyond: what lies within may be plain.
  double ChanceBeyond(int s, const EdgeKind& kind) const;

 private:
  class OneWay {
   public:
    // \param changes  at each step of the next line; negative: not seen. \param pitches  [px] of its steps.
    void AddLine(const std::vector<float>& changes, const std::vector<double>& pitches);
    // Once all lines are added.
    void FindThresholds();

    bool IsSeen(size_t line, int s) const { return nearest_[line * num_steps_ + s] >= 0; }
    // Whether there is an edge next to a step. \param threshold  of what is one.
    bool IsNearEdge(size_t line, int s, float threshold) const {
      return nearest_[line * num_steps_ + s] > threshold;
    }
    bool IsEdge(size_t line, int s, float threshold) const {
      return edges_[line * num_steps_ + s] > threshold;
    }
    float Threshold(size_t line, int s, bool is_local) const {
      return is_local ? local_thresholds_[line * num_steps_ + s] : thresholds_[s];
    }

   private:
    std::vector<float> ThresholdsOf(const std::vector<size_t>& lines) const;

    size_t num_lines_ = 0;
    int num_steps_ = 0;
    std::vector<float> changes_;  // by line and step; negative: not seen
    std::vector<float> edges_;    // by line and step: the changes that are the clearest within kEdgeApartPx
    std::vector<float> nearest_;  // the clearest edge there, by line and step; negative: not seen
    std::vector<float> thresholds_;        // by step: what is no change of the surface within
    std::vector<float> local_thresholds_;  // by line and step: the same about the line
  };

  void AddLine(const StillPicture& picture, const ArcLines& lines);
  void Count(size_t line, int s, const ColorChange& thresholds, int num_ways, Ring* ring) const;

  size_t num_lines_;
  int num_steps_;
  std::array<OneWay, kColorWays> ways_;
};

}  // namespace s2gs
