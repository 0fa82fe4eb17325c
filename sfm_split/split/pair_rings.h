#pragma once

#include <utility>
#include <vector>

namespace s2gs {

/// How many of `count` photos lie on rings of pairs that hang together: the largest set of photos in which
/// any two stay joined whichever single pair is taken away (two-edge-connected; Tarjan 1974). A pair that
/// alone joins two parts of a scan has nothing that checks it, and an error of it turns all that lies
/// behind it. A single photo is such a set; 0 when there are no photos.
/// \param pairs  of photos below `count`; the same pair twice counts as one.
int LargestRing(int count, const std::vector<std::pair<int, int>>& pairs);

}  // namespace s2gs
