#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {

/// Length of a SIFT descriptor in bytes.
inline constexpr int kDescriptorSize = 128;

/// Which nearest neighbours count as a match. Names, defaults and meaning are COLMAP's (`SiftMatching`).
/// The distance of two descriptors a, b (bytes, norm about 512) is acos(min(a·b / 512², 1)) in radians.
struct DescriptorMatchOptions {
  double max_ratio = 0.8;     ///< best distance < max_ratio * second best distance.
  double max_distance = 0.7;  ///< best distance <= max_distance, in radians.
  bool cross_check = true;  ///< the best match of the other direction must be the same, and pass both tests.

  OptionCheck Check() const;
};

/// The instructions that compute dot products. Every one gives the same matches, bit for bit.
enum class MatchInstructions {
  kAuto,        ///< the fastest that this processor has.
  kPortable,    ///< plain C++.
  kAvx2,        ///< 8-bit multiply-add into 16 bits.
  kAvx512Vnni,  ///< 8-bit multiply-add into 32 bits.
};

/// True when this processor can run `instructions`.
bool MatchInstructionsAvailable(MatchInstructions instructions);

/// The descriptors of one image, or of some of its keypoints, in the order that the kernels read: groups of
/// 16 descriptors, interleaved by 4 bytes, bytes permuted. Costs one pass over the descriptors, so prepare an
/// image once and match it against many.
class PackedDescriptors {
 public:
  static constexpr int kGroupSize = 16;  // 32-bit lanes of a register of AVX-512
  struct alignas(64) Group {
    uint8_t bytes[kDescriptorSize / 4][kGroupSize][4];
  };

  PackedDescriptors() = default;

  /// \param descriptors  num_descriptors x 128 bytes, row-major, as COLMAP's database has them.
  PackedDescriptors(const uint8_t* descriptors, size_t num_descriptors);

  /// Only the rows `subset` of the descriptors. Matches name the rows of the whole array, not of the subset.
  /// \param subset  strictly ascending, each below num_descriptors.
  PackedDescriptors(const uint8_t* descriptors, size_t num_descriptors, const std::vector<uint32_t>& subset);

  /// Number of descriptors (the subset's).
  size_t size() const { return size_; }
  size_t MemoryBytes() const;

  /// How large a descriptor's bytes are, which decides how products can be summed (descriptor_kernel.h).
  enum Weight { kLight, kMedium, kHeavy, kNumWeights };

  /// Groups of light descriptors, then of medium, then of heavy ones. A slot is a descriptor's place here.
  const std::vector<Group>& groups() const { return groups_; }
  /// First group of a weight; group_begin(kNumWeights) is the number of groups.
  int group_begin(int weight) const { return group_begin_[weight]; }
  /// Per slot: the row in the array given, or kPadding.
  const std::vector<uint32_t>& slot_index() const { return slot_index_; }
  /// Per slot: the sum of the descriptor's bytes.
  const std::vector<int32_t>& slot_sum() const { return slot_sum_; }

  static constexpr uint32_t kPadding = UINT32_MAX;  ///< of slot_index(): no row of the array

 private:
  void Pack(const uint8_t* descriptors, const uint32_t* subset, size_t num);

  size_t size_ = 0;
  std::array<int, kNumWeights + 1> group_begin_{};
  std::vector<Group> groups_;
  std::vector<uint32_t> slot_index_;
  std::vector<int32_t> slot_sum_;
};

/// Exact brute-force matcher of 8-bit SIFT descriptors. One pass over all pairs of descriptors finds the best
/// and second best of every row and of every column, so the mutual check costs no second pass. Among equal
/// best candidates the lowest row wins. Matches are identical for every instruction set and thread count.
///
/// Cost: n1 * n2 * 128 multiply-adds a pair of images; memory O(n1 + n2) a thread, kept between calls.
class DescriptorMatcher {
 public:
  /// \param num_threads   threads to use; 0: OpenMP's default.
  /// \param instructions  must be available on this processor.
  explicit DescriptorMatcher(const DescriptorMatchOptions& options, int num_threads = 0,
                             MatchInstructions instructions = MatchInstructions::kAuto);
  ~DescriptorMatcher();
  DescriptorMatcher(const DescriptorMatcher&) = delete;
  DescriptorMatcher& operator=(const DescriptorMatcher&) = delete;

  /// Matches one pair of images with all threads.
  /// \param matches  replaced by the matches in ascending point2D_idx1.
  void Match(const PackedDescriptors& image1, const PackedDescriptors& image2, FeatureMatches* matches);

  struct Job {
    const PackedDescriptors* image1 = nullptr;
    const PackedDescriptors* image2 = nullptr;
  };

  /// Matches many pairs, one thread a pair (all threads inside each pair when there are few pairs).
  /// \param matches  resized to jobs.size(); element i is what Match() gives for job i.
  void MatchAll(const std::vector<Job>& jobs, std::vector<FeatureMatches>* matches);

  int num_threads() const { return num_threads_; }

 private:
  struct Workspace;
  void MatchRows(const PackedDescriptors& image1, const PackedDescriptors& image2, int chunk,
                 Workspace* columns, Workspace* rows) const;
  void Select(const PackedDescriptors& image1, const PackedDescriptors& image2, const Workspace& rows,
              const Workspace& columns, FeatureMatches* matches) const;

  float max_ratio_;
  float max_distance_;
  bool cross_check_;
  int num_threads_;
  MatchInstructions instructions_;
  std::vector<std::unique_ptr<Workspace>> workspaces_;  // one a thread
};

}  // namespace s2gs
