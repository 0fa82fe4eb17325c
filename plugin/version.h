#pragma once

#include <string>

namespace s2gs {

/// The project's version, e.g. "0.1.0".
std::string Version();

/// What `s2gs --version` prints: the version and how this program was built.
std::string VersionText();

}  // namespace s2gs
