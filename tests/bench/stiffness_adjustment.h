#pragma once

namespace s2gs {

/// Prints the joint adjustment's two parts of the page. \param steps  photos of each station.
void PrintAdjustmentStiffness(int steps);

}  // namespace s2gs
