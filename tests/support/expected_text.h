#pragma once

#include <string>

namespace s2gs {

/// Compares a text with tests/PATH, word for word. Numbers count as equal when they differ by no more than
/// one in their last written digit and 1e-4 of their size: compilers may round the last bit differently.
/// With S2GS_WRITE_EXPECTED=1 in the environment the file is written instead and the test fails: to be looked
/// at, figure by figure, before it is kept.
/// \param path  relative to the folder `tests`.
void ExpectText(const std::string& text, const std::string& path);

}  // namespace s2gs
