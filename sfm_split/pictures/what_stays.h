#pragma once

#include <cstddef>
#include <vector>

#include "sfm_split/pictures/picture_comparison.h"

namespace s2gs {

/// Half of fewer photos of a station is one photo, which tells nothing of what stays.
constexpr size_t kMinPersistencePhotos = 4;

/// What is found in most of a station's photos, and how often it lies elsewhere. A tile of little texture
/// before noise, of a checked cloth or of what turns lies elsewhere now and then in every photo: only more of
/// them than that makes a photo of another place.
class WhatStays {
 public:
  /// \param comparisons  with one standard. \param members  places of the station's own among them, one at
  /// least.
  WhatStays(const std::vector<PictureComparison>& comparisons, const std::vector<int>& members);

  /// Per tile: whether it is found elsewhere or not at all in most photos.
  std::vector<char> PassingTiles() const;

  /// Of a comparison with the same standard: whether much of what stays lies elsewhere.
  bool HasMovedIn(const PictureComparison& comparison) const;

 private:
  double needed_;
  std::vector<int> num_found_;
  std::vector<int> num_elsewhere_;
};

/// Leaves those members out in which much of what stays in place in most of them lies elsewhere. Those of
/// fewer than kMinPersistencePhotos stay.
void LeaveOutMoved(const std::vector<PictureComparison>& comparisons, std::vector<int>* members);

/// What is found in few of a station's photos turns or passes by. It may move as one from photo to photo, and
/// be taken for the camera's own motion, and where it fills the picture what stays is a small share of all:
/// such photos are compared again by what stays alone.
/// \param images  of the pictures: those that were compared with the standard, in the comparisons' order.
void CompareByWhatStays(const PictureStandard& standard, const std::vector<GreyPicture>& pictures,
                        const std::vector<int>& images, std::vector<PictureComparison>* comparisons);

/// A body that is much the same from all around, beside the axis, goes to and fro, and is found in one photo
/// as in the others: where it speaks for a photo's motion, that is looked for by what stays alone.
/// \param images  as above. \param members  places of the station's own among the comparisons.
void CompareWithoutPassing(const PictureStandard& standard, const std::vector<GreyPicture>& pictures,
                           const std::vector<int>& images, const std::vector<int>& members,
                           std::vector<PictureComparison>* comparisons);

}  // namespace s2gs
