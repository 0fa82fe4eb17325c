#pragma once

#include <string>

namespace s2gs {

/// The project's version, e.g. "0.1.0".
std::string Version();

/// The version and how this program was built, on one line.
std::string VersionText();

/// A line for each GPU of this machine and whether this program can use it; empty when there is none.
std::string GpuText();

}  // namespace s2gs
