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
};

/// Joins images that see the same unmoved background, strongest pairs first.
/// Every pair in `pairs` is judged; pairs that were not matched say nothing. A chain of small steps that adds
/// up to more than max_shake_px is a moving camera, not a station: the weakest joins are then left out.
Stations FindStations(const std::vector<Keypoints>& keypoints,
                      const std::vector<Eigen::Vector2i>& image_sizes,
                      const std::vector<ImagePairMatches>& pairs, const StationOptions& options);

}  // namespace s2gs
