#include "mesh/texture/pack_rectangles.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// How much larger the next page is that is tried when all do not fit.
constexpr double kGrowth = 1.04;

// The lower border of what is placed on a page, as steps from left to right.
class Skyline {
 public:
  Skyline(int width, int height) : width_(width), height_(height), steps_{{0, 0}} {}

  // Places the rectangle where its top row is first, then leftmost. False when it fits nowhere.
  bool Place(const RectangleSize& size, PackedRectangle* place) {
    size_t best = steps_.size();
    int best_y = std::numeric_limits<int>::max();
    for (size_t i = 0; i < steps_.size() && steps_[i].x + size.width <= width_; ++i) {
      const int y = HeightOver(i, size.width);
      if (y + size.height <= height_ && y < best_y) {
        best = i;
        best_y = y;
      }
    }
    if (best == steps_.size()) return false;
    place->x = steps_[best].x;
    place->y = best_y;
    Raise(best, size.width, best_y + size.height);
    used_height_ = std::max(used_height_, best_y + size.height);
    used_width_ = std::max(used_width_, place->x + size.width);
    return true;
  }

  RectangleSize Used() const { return {used_width_, used_height_}; }

 private:
  struct Step {
    int x;
    int y;
  };

  int HeightOver(size_t first, int width) const {
    const int end = steps_[first].x + width;
    int y = 0;
    for (size_t i = first; i < steps_.size() && steps_[i].x < end; ++i) y = std::max(y, steps_[i].y);
    return y;
  }

  void Raise(size_t first, int width, int y) {
    const int begin = steps_[first].x;
    const int end = begin + width;
    size_t last = first;
    int last_y = steps_[first].y;
    while (last < steps_.size() && steps_[last].x < end) last_y = steps_[last++].y;
    const bool has_rest = end < width_ && (last == steps_.size() || steps_[last].x > end);
    const auto at = [&](size_t i) { return steps_.begin() + static_cast<std::ptrdiff_t>(i); };
    steps_.erase(at(first), at(last));
    if (has_rest) steps_.insert(at(first), {end, last_y});
    steps_.insert(at(first), {begin, y});
  }

  int width_;
  int height_;
  std::vector<Step> steps_;
  int used_width_ = 0;
  int used_height_ = 0;
};

// All rectangles on as many pages of that size as they need.
Packing PackInOrder(const std::vector<RectangleSize>& rectangles, const std::vector<size_t>& order, int width,
                    int height, size_t max_pages) {
  Packing packing;
  packing.places.resize(rectangles.size());
  std::vector<Skyline> skylines;
  for (const size_t i : order) {
    PackedRectangle& place = packing.places[i];
    place.page = -1;
    for (size_t page = 0; page < skylines.size() && place.page < 0; ++page) {
      if (skylines[page].Place(rectangles[i], &place)) place.page = static_cast<int>(page);
    }
    if (place.page >= 0) continue;
    if (skylines.size() == max_pages) return {};
    skylines.emplace_back(width, height);
    place.page = static_cast<int>(skylines.size() - 1);
    if (!skylines.back().Place(rectangles[i], &place)) return {};
  }
  for (const Skyline& skyline : skylines) packing.pages.push_back(skyline.Used());
  return packing;
}

}  // namespace

Packing PackRectangles(const std::vector<RectangleSize>& rectangles, int max_side) {
  if (rectangles.empty()) return {};
  std::vector<size_t> order(rectangles.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    if (rectangles[a].height != rectangles[b].height) return rectangles[a].height > rectangles[b].height;
    if (rectangles[a].width != rectangles[b].width) return rectangles[a].width > rectangles[b].width;
    return a < b;
  });
  double area = 0;
  int least = 1;
  for (const RectangleSize& size : rectangles) {
    S2GS_INVARIANT(size.width > 0 && size.height > 0 && size.width <= max_side && size.height <= max_side);
    area += static_cast<double>(size.width) * size.height;
    least = std::max({least, size.width, size.height});
  }
  double side = std::max(static_cast<double>(least), std::sqrt(area));
  while (side <= max_side) {
    const int tried = static_cast<int>(std::ceil(side));
    Packing packing = PackInOrder(rectangles, order, tried, tried, 1);
    if (!packing.pages.empty()) return packing;
    side = std::min(std::max(side * kGrowth, side + 1), side < max_side ? max_side : max_side + 1.0);
  }
  return PackInOrder(rectangles, order, max_side, max_side, rectangles.size());
}

}  // namespace s2gs
