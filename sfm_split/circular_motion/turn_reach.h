#pragma once

#include <vector>

namespace s2gs {

// How far a turn of the table moves what a photo shows. A point that turns by an angle moves no farther than
// its distance from the axis times the chord, and what the object sweeps over a station's photos is at least
// that wide.

/// Of what is near over what is far, on a turntable, at most.
inline constexpr double kMagnification = 2;

/// What keypoints sweep [px], the wider of both directions; a few of them may be anywhere.
double SweptPx(std::vector<float> x, std::vector<float> y);

}  // namespace s2gs
