#pragma once

#include <cstddef>
#include <utility>

namespace s2gs {

/// Uphill along each of a state's numbers in turn, forth and back, in steps that are halved where none
/// improves, down to `last_step`. Returns the value at the top.
/// \param moved    (state, number, step): the state with one of its numbers moved.
/// \param value    of a state.
template <typename State, typename Moved, typename Value>
double Climb(size_t num_numbers, double first_step, double last_step, const Moved& moved, const Value& value,
             State* state) {
  double best = value(*state);
  for (double step = first_step; step > last_step;) {
    bool has_improved = false;
    for (size_t number = 0; number < num_numbers; ++number) {
      for (const double way : {step, -step}) {
        State there = moved(*state, number, way);
        const double here = value(there);
        if (here <= best) continue;
        best = here;
        *state = std::move(there);
        has_improved = true;
      }
    }
    if (!has_improved) step *= 0.5;
  }
  return best;
}

}  // namespace s2gs
