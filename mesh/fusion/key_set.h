#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace s2gs {

/// A set of 64-bit keys for many insertions of few distinct ones. ~0 is no key.
class KeySet {
 public:
  KeySet() : table_(kFirstCapacity, kEmpty) {}

  size_t size() const { return size_; }

  void Insert(uint64_t key) {
    if (!Place(key)) return;
    if (++size_ * 2 <= table_.size()) return;
    std::vector<uint64_t> old(2 * table_.size(), kEmpty);
    old.swap(table_);
    for (const uint64_t old_key : old) {
      if (old_key != kEmpty) Place(old_key);
    }
  }

  std::vector<uint64_t> Sorted() const {
    std::vector<uint64_t> keys;
    keys.reserve(size_);
    for (const uint64_t key : table_) {
      if (key != kEmpty) keys.push_back(key);
    }
    std::sort(keys.begin(), keys.end());
    return keys;
  }

 private:
  static constexpr uint64_t kEmpty = ~uint64_t{0};
  static constexpr size_t kFirstCapacity = 1024;

  // Returns whether it is new.
  bool Place(uint64_t key) {
    const size_t mask = table_.size() - 1;
    size_t i = static_cast<size_t>((key * 0x9e3779b97f4a7c15ULL) >> 20U) & mask;
    for (; table_[i] != kEmpty; i = (i + 1) & mask) {
      if (table_[i] == key) return false;
    }
    table_[i] = key;
    return true;
  }

  std::vector<uint64_t> table_;
  size_t size_ = 0;
};

}  // namespace s2gs
