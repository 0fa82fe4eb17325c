#include <algorithm>
#include <utility>

#include "mesh/fusion/tsdf.h"

namespace s2gs {
namespace {

// Spreads 21 bits to every third one.
uint64_t Spread(uint64_t x) {
  x &= 0x1fffffU;
  x = (x | x << 32U) & 0x1f00000000ffffULL;
  x = (x | x << 16U) & 0x1f0000ff0000ffULL;
  x = (x | x << 8U) & 0x100f00f00f00f00fULL;
  x = (x | x << 4U) & 0x10c30c30c30c30c3ULL;
  return (x | x << 2U) & 0x1249249249249249ULL;
}

uint64_t Gather(uint64_t x) {
  x &= 0x1249249249249249ULL;
  x = (x | x >> 2U) & 0x10c30c30c30c30c3ULL;
  x = (x | x >> 4U) & 0x100f00f00f00f00fULL;
  x = (x | x >> 8U) & 0x1f0000ff0000ffULL;
  x = (x | x >> 16U) & 0x1f00000000ffffULL;
  return (x | x >> 32U) & 0x1fffffU;
}

constexpr int kBias = 1 << 20;

size_t Hash(uint64_t key) { return static_cast<size_t>((key * 0x9e3779b97f4a7c15ULL) >> 24U); }

}  // namespace

uint64_t TsdfBlockIndex::BlockKey(const Eigen::Vector3i& block) {
  const auto biased = [](int coordinate) { return Spread(static_cast<uint64_t>(coordinate + kBias)); };
  return biased(block.x()) | biased(block.y()) << 1U | biased(block.z()) << 2U;
}

Eigen::Vector3i TsdfBlockIndex::BlockOfKey(uint64_t key) {
  const auto plain = [](uint64_t bits) { return static_cast<int>(Gather(bits)) - kBias; };
  return {plain(key), plain(key >> 1U), plain(key >> 2U)};
}

TsdfBlockIndex::TsdfBlockIndex(std::vector<uint64_t> keys) : keys_(std::move(keys)) {
  S2GS_INVARIANT(keys_.size() < (size_t{1} << 30U));
  size_t capacity = 16;
  while (capacity < 2 * keys_.size()) capacity *= 2;
  table_.assign(capacity, kNone);
  for (size_t i = 0; i < keys_.size(); ++i) {
    S2GS_INVARIANT(i == 0 || keys_[i - 1] < keys_[i]);
    size_t slot = Hash(keys_[i]) & (capacity - 1);
    while (table_[slot] != kNone) slot = (slot + 1) & (capacity - 1);
    table_[slot] = static_cast<int32_t>(i);
  }
}

Eigen::Vector3i TsdfBlockIndex::Block(int index) const { return BlockOfKey(keys_[index]); }

int TsdfBlockIndex::Find(const Eigen::Vector3i& block) const {
  if (table_.empty() || block.cwiseAbs().maxCoeff() > kMaxCoordinate) return kNone;
  const uint64_t key = BlockKey(block);
  const size_t mask = table_.size() - 1;
  for (size_t slot = Hash(key) & mask; table_[slot] != kNone; slot = (slot + 1) & mask) {
    if (keys_[table_[slot]] == key) return table_[slot];
  }
  return kNone;
}

}  // namespace s2gs
