#include "s2gs/training/photo_order.h"

#include <numeric>
#include <utility>

#include "s2gs/core/rng.h"

namespace s2gs {
namespace {

constexpr uint64_t kOrderStream = 201;  // of random numbers.

}  // namespace

PhotoOrder::PhotoOrder(size_t count, uint64_t seed) : order_(count), seed_(seed) {}

int64_t PhotoOrder::RoundOf(int64_t iteration) const {
  return (iteration - 1) / static_cast<int64_t>(order_.size());
}

int PhotoOrder::At(int64_t iteration) {
  const int64_t round = RoundOf(iteration);
  if (round != round_) Shuffle(round);
  return order_[(iteration - 1) % static_cast<int64_t>(order_.size())];
}

void PhotoOrder::Shuffle(int64_t round) {
  std::iota(order_.begin(), order_.end(), 0);
  for (size_t i = order_.size(); i > 1; --i) {
    const Random4 bits = RandomBits(seed_, kOrderStream + (static_cast<uint64_t>(round) << 16U), i);
    const auto j = static_cast<size_t>(UnitDouble(bits.words[0]) * static_cast<double>(i));
    std::swap(order_[i - 1], order_[j]);
  }
  round_ = round;
}

}  // namespace s2gs
