#include "sfm_split/matching/descriptor_match.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <string>

#include "sfm_split/base/number_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/matching/descriptor_kernel.h"

namespace s2gs {
namespace {

constexpr int kGroupSize = PackedDescriptors::kGroupSize;    // descriptors
constexpr int kGroupsPerChunk = kRowsPerBlock / kGroupSize;  // what one block of rows takes
static_assert(kRowsPerBlock % kGroupSize == 0);

struct TopTwo {
  int32_t best = 0;  // dot products
  int32_t second = 0;
  uint32_t slot = PackedDescriptors::kPadding;  // of the best, in the other image
};

// Takes up a block's keys; order of the blocks does not matter.
void Merge(int32_t best_key, int32_t second_key, uint32_t first_slot, const std::vector<uint32_t>& slot_index,
           TopTwo* top) {
  const int32_t dot = best_key >> kKeyIndexBits;
  const uint32_t slot = first_slot + static_cast<uint32_t>(kKeyIndexMask - (best_key & kKeyIndexMask));
  const bool wins =
      dot > top->best || (dot == top->best && dot > 0 && slot_index[slot] < slot_index[top->slot]);
  if (wins) {
    top->second = std::max(top->best, second_key >> kKeyIndexBits);
    top->best = dot;
    top->slot = slot;
  } else {
    top->second = std::max(top->second, dot);
  }
}

void Merge(const TopTwo& from, const std::vector<uint32_t>& slot_index, TopTwo* top) {
  const bool wins = from.best > top->best || (from.best == top->best && from.best > 0 &&
                                              slot_index[from.slot] < slot_index[top->slot]);
  if (wins) {
    top->second = std::max(top->best, from.second);
    top->best = from.best;
    top->slot = from.slot;
  } else {
    top->second = std::max(top->second, from.best);
  }
}

BlockKernel KernelOf(MatchInstructions instructions) {
  switch (instructions) {
#if defined(__x86_64__)
    case MatchInstructions::kAvx2:
      return MatchBlockAvx2;
    case MatchInstructions::kAvx512Vnni:
      return MatchBlockAvx512Vnni;
#endif
    default:
      return MatchBlockPortable;
  }
}

MatchInstructions Fastest() {
  for (const auto instructions : {MatchInstructions::kAvx512Vnni, MatchInstructions::kAvx2}) {
    if (MatchInstructionsAvailable(instructions)) return instructions;
  }
  return MatchInstructions::kPortable;
}

// In single precision, as COLMAP computes it: the ratio test then rounds alike.
float Distance(int32_t dot) {
  constexpr float kInverseSquaredNorm = 1.0F / (512.0F * 512.0F);  // COLMAP stores unit vectors times 512
  return std::acos(std::min(kInverseSquaredNorm * static_cast<float>(dot), 1.0F));
}

int NumChunks(int num_groups) { return (num_groups + kGroupsPerChunk - 1) / kGroupsPerChunk; }

int NumChunks(const PackedDescriptors& image) {
  int num_chunks = 0;
  for (int w = 0; w < PackedDescriptors::kNumWeights; ++w) {
    num_chunks += NumChunks(image.group_begin(w + 1) - image.group_begin(w));
  }
  return num_chunks;
}

struct GroupRange {
  int begin = 0;
  int end = 0;
  PackedDescriptors::Weight weight = PackedDescriptors::kLight;
};

// The groups of one weight that start at `begin`, at most max_groups.
GroupRange RangeAt(const PackedDescriptors& image, int begin, int max_groups) {
  int weight = 0;
  while (begin >= image.group_begin(weight + 1)) ++weight;
  return {begin, std::min(begin + max_groups, image.group_begin(weight + 1)),
          static_cast<PackedDescriptors::Weight>(weight)};
}

GroupRange Chunk(const PackedDescriptors& image, int chunk) {
  int weight = 0;
  while (true) {
    const int begin = image.group_begin(weight);
    const int num_chunks = NumChunks(image.group_begin(weight + 1) - begin);
    if (chunk < num_chunks) return RangeAt(image, begin + chunk * kGroupsPerChunk, kGroupsPerChunk);
    chunk -= num_chunks;
    ++weight;
  }
}

void ReadRows(const PackedDescriptors::Group* groups, int num_groups, RowBlock* rows) {
  rows->num_rows = num_groups * kGroupSize;
  for (int g = 0; g < num_groups; ++g) {
    for (int k = 0; k < kDescriptorSize / 4; ++k) {
      for (int c = 0; c < kGroupSize; ++c) {
        std::memcpy(rows->bytes[g * kGroupSize + c] + 4 * k, groups[g].bytes[k][c], 4);
      }
    }
  }
  std::memset(rows->bytes[rows->num_rows], 0, (kRowsPerBlock - rows->num_rows) * sizeof(rows->bytes[0]));
}

}  // namespace

OptionCheck DescriptorMatchOptions::Check() const {
  if (!(max_ratio > 0.0 && max_ratio <= 1.0)) {
    return OptionFault{"max_ratio", NumberText(max_ratio), "0 < max_ratio <= 1"};
  }
  if (!(max_distance > 0.0) || !std::isfinite(max_distance)) {
    return OptionFault{"max_distance", NumberText(max_distance), "max_distance > 0"};
  }
  return std::nullopt;
}

bool MatchInstructionsAvailable(MatchInstructions instructions) {
  switch (instructions) {
    case MatchInstructions::kAuto:
    case MatchInstructions::kPortable:
      return true;
#if defined(__x86_64__)
    case MatchInstructions::kAvx2:
      return __builtin_cpu_supports("avx2") != 0;
    case MatchInstructions::kAvx512Vnni:
      return __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512bw") != 0 &&
             __builtin_cpu_supports("avx512vl") != 0 && __builtin_cpu_supports("avx512vnni") != 0;
#endif
    default:
      return false;
  }
}

// --- PackedDescriptors -------------------------------------------------------------------------------------

PackedDescriptors::PackedDescriptors(const uint8_t* descriptors, size_t num_descriptors) {
  Pack(descriptors, nullptr, num_descriptors);
}

PackedDescriptors::PackedDescriptors(const uint8_t* descriptors, size_t num_descriptors,
                                     const std::vector<uint32_t>& subset) {
  for (size_t i = 0; i < subset.size(); ++i) {
    S2GS_INVARIANT(subset[i] < num_descriptors && (i == 0 || subset[i - 1] < subset[i]));
  }
  Pack(descriptors, subset.data(), subset.size());
}

size_t PackedDescriptors::MemoryBytes() const {
  return groups_.capacity() * sizeof(Group) + slot_index_.capacity() * sizeof(slot_index_[0]) +
         slot_sum_.capacity() * sizeof(slot_sum_[0]);
}

void PackedDescriptors::Pack(const uint8_t* descriptors, const uint32_t* subset, size_t num) {
  S2GS_INVARIANT(num < size_t{1} << 30);
  static const auto kPermutation = [] {
    std::array<uint8_t, kDescriptorSize> permutation{};
    for (int i = 0; i < kDescriptorSize; ++i) permutation[i] = static_cast<uint8_t>(DescriptorPermutation(i));
    return permutation;
  }();
  size_ = num;
  std::vector<uint8_t> packed(num * kDescriptorSize);
  std::vector<uint8_t> weights(num);
  std::array<size_t, kNumWeights> count{};
  for (size_t i = 0; i < num; ++i) {
    const uint8_t* from = descriptors + (subset != nullptr ? subset[i] : i) * kDescriptorSize;
    uint8_t* to = packed.data() + i * kDescriptorSize;
    for (int k = 0; k < kDescriptorSize; ++k) to[k] = from[kPermutation[k]];
    weights[i] = static_cast<uint8_t>(DescriptorWeight(to));
    ++count[weights[i]];
  }
  std::array<size_t, kNumWeights> next_slot{};
  for (int w = 0; w < kNumWeights; ++w) {
    next_slot[w] = static_cast<size_t>(group_begin_[w]) * kGroupSize;
    group_begin_[w + 1] = group_begin_[w] + static_cast<int>((count[w] + kGroupSize - 1) / kGroupSize);
  }
  groups_.assign(group_begin_[kNumWeights], Group{});
  slot_index_.assign(groups_.size() * kGroupSize, kPadding);
  slot_sum_.assign(groups_.size() * kGroupSize, 0);
  for (size_t i = 0; i < num; ++i) {
    const size_t slot = next_slot[weights[i]]++;
    slot_index_[slot] = subset != nullptr ? subset[i] : static_cast<uint32_t>(i);
    const uint8_t* from = packed.data() + i * kDescriptorSize;
    Group& group = groups_[slot / kGroupSize];
    for (int k = 0; k < kDescriptorSize / 4; ++k) {
      std::memcpy(group.bytes[k][slot % kGroupSize], from + 4 * k, 4);
    }
    for (int k = 0; k < kDescriptorSize; ++k) slot_sum_[slot] += from[k];
  }
}

// --- DescriptorMatcher -------------------------------------------------------------------------------------

struct DescriptorMatcher::Workspace {
  RowBlock rows;
  BlockKeys keys;
  std::vector<TopTwo> row_top;
  std::vector<TopTwo> column_top;

  void Reset(const PackedDescriptors& image1, const PackedDescriptors& image2) {
    row_top.assign(image1.slot_index().size(), TopTwo{});
    column_top.assign(image2.slot_index().size(), TopTwo{});
  }
};

DescriptorMatcher::DescriptorMatcher(const DescriptorMatchOptions& options, int num_threads,
                                     MatchInstructions instructions)
    : max_ratio_(static_cast<float>(options.max_ratio)),
      max_distance_(static_cast<float>(options.max_distance)),
      cross_check_(options.cross_check),
      num_threads_(NumThreadsOf(num_threads)),
      instructions_(instructions == MatchInstructions::kAuto ? Fastest() : instructions) {
  S2GS_INVARIANT(!options.Check().has_value());
  S2GS_INVARIANT(MatchInstructionsAvailable(instructions_));
  for (int i = 0; i < num_threads_; ++i) workspaces_.push_back(std::make_unique<Workspace>());
}

DescriptorMatcher::~DescriptorMatcher() = default;

// One chunk of image1's groups against all of image2.
void DescriptorMatcher::MatchRows(const PackedDescriptors& image1, const PackedDescriptors& image2, int chunk,
                                  Workspace* columns, Workspace* rows) const {
  const GroupRange range1 = Chunk(image1, chunk);
  ReadRows(image1.groups().data() + range1.begin, range1.end - range1.begin, &columns->rows);

  const BlockKernel kernel = KernelOf(instructions_);
  const int num_groups2 = image2.group_begin(PackedDescriptors::kNumWeights);
  for (GroupRange range2; range2.end < num_groups2;) {
    range2 = RangeAt(image2, range2.end, kGroupsPerBlock);
    BlockKeys& keys = columns->keys;
    kernel(columns->rows, image2.groups().data() + range2.begin,
           image2.slot_sum().data() + range2.begin * kGroupSize, range2.end - range2.begin, range1.weight,
           range2.weight, &keys);
    const auto first_row = static_cast<uint32_t>(range1.begin * kGroupSize);
    const auto first_column = static_cast<uint32_t>(range2.begin * kGroupSize);
    for (int i = 0; i < columns->rows.num_rows; ++i) {
      Merge(keys.row_best[i], keys.row_second[i], first_column, image2.slot_index(),
            &rows->row_top[first_row + i]);
    }
    for (int i = 0; i < (range2.end - range2.begin) * kGroupSize; ++i) {
      Merge(keys.column_best[i], keys.column_second[i], first_row, image1.slot_index(),
            &columns->column_top[first_column + i]);
    }
  }
}

void DescriptorMatcher::Select(const PackedDescriptors& image1, const PackedDescriptors& image2,
                               const Workspace& rows, const Workspace& columns,
                               FeatureMatches* matches) const {
  const auto passes = [&](const TopTwo& top) {
    if (top.best == 0) return false;
    const float best = Distance(top.best);
    return best <= max_distance_ && best < max_ratio_ * Distance(top.second);
  };
  matches->clear();
  for (size_t slot = 0; slot < rows.row_top.size(); ++slot) {
    const uint32_t index1 = image1.slot_index()[slot];
    const TopTwo& top = rows.row_top[slot];
    if (index1 == PackedDescriptors::kPadding || !passes(top)) continue;
    if (cross_check_) {
      const TopTwo& back = columns.column_top[top.slot];
      if (back.slot != slot || !passes(back)) continue;
    }
    matches->push_back({index1, image2.slot_index()[top.slot]});
  }
  std::sort(matches->begin(), matches->end(),
            [](const FeatureMatch& a, const FeatureMatch& b) { return a.point2D_idx1 < b.point2D_idx1; });
}

void DescriptorMatcher::Match(const PackedDescriptors& image1, const PackedDescriptors& image2,
                              FeatureMatches* matches) {
  const int num_chunks = NumChunks(image1);
  const int num_used = std::max(1, std::min(num_threads_, num_chunks));
  for (int i = 0; i < num_used; ++i) workspaces_[i]->Reset(image1, image2);
  Workspace* first = workspaces_[0].get();
  ParallelFor(num_chunks, num_used, [&](int64_t chunk) {
    MatchRows(image1, image2, static_cast<int>(chunk), workspaces_[LoopThread()].get(), first);
  });
  for (int i = 1; i < num_used; ++i) {
    for (size_t slot = 0; slot < first->column_top.size(); ++slot) {
      Merge(workspaces_[i]->column_top[slot], image1.slot_index(), &first->column_top[slot]);
    }
  }
  Select(image1, image2, *first, *first, matches);
}

void DescriptorMatcher::MatchAll(const std::vector<Job>& jobs, std::vector<FeatureMatches>* matches) {
  matches->resize(jobs.size());
  const int num_jobs = static_cast<int>(jobs.size());
  if (num_jobs < 2 * num_threads_) {
    for (int i = 0; i < num_jobs; ++i) Match(*jobs[i].image1, *jobs[i].image2, &(*matches)[i]);
    return;
  }
  ParallelFor(num_jobs, num_threads_, [&](int64_t i) {
    const PackedDescriptors& image1 = *jobs[i].image1;
    const PackedDescriptors& image2 = *jobs[i].image2;
    Workspace* workspace = workspaces_[LoopThread()].get();
    workspace->Reset(image1, image2);
    for (int chunk = 0; chunk < NumChunks(image1); ++chunk) {
      MatchRows(image1, image2, chunk, workspace, workspace);
    }
    Select(image1, image2, *workspace, *workspace, &(*matches)[i]);
  });
}

}  // namespace s2gs
