#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace s2gs {

/// Numbers all images' keypoints in one row: the first image's, then the second's, and so on.
class KeypointNumbers {
 public:
  /// The next image's.
  void Add(size_t num_keypoints) { first_.push_back(first_.back() + num_keypoints); }

  /// \param image  in the order of Add().
  uint32_t Of(int image, uint32_t keypoint) const {
    return static_cast<uint32_t>(first_[static_cast<size_t>(image)] + keypoint);
  }
  /// How many there are.
  size_t Count() const { return first_.back(); }

 private:
  std::vector<size_t> first_ = {0};  // of each image; of all of them at the end
};

}  // namespace s2gs
