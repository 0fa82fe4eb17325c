#pragma once

#include <vector>

namespace s2gs {

/// A rectangle's place on a page.
struct PackedRectangle {
  int page = 0;
  int x = 0;  ///< of its left column [px].
  int y = 0;  ///< of its top row [px].
};

struct RectangleSize {
  int width = 0;   ///< [px]
  int height = 0;  ///< [px]
};

struct Packing {
  std::vector<PackedRectangle> places;  ///< one for each rectangle, in their order.
  std::vector<RectangleSize> pages;     ///< what is used of each page.
};

/// Places rectangles on pages so that none overlap: the highest first, each where its top is highest on the
/// skyline of those before it ("bottom-left" of Jylanki, "A thousand ways to pack the bin", 2010). Where one
/// page is enough it is about square and no larger than it must be; where several are needed, all but the
/// last are full. \param rectangles  no side is larger than `max_side`.
Packing PackRectangles(const std::vector<RectangleSize>& rectangles, int max_side);

}  // namespace s2gs
