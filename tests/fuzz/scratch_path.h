#pragma once

#include <unistd.h>

#include <filesystem>
#include <string>

namespace s2gs {

/// A name of this process alone, where there is no disk: the code under test reads files only.
inline std::filesystem::path ScratchPath(const std::string& name) {
  namespace fs = std::filesystem;
  static const fs::path folder = fs::is_directory("/dev/shm") ? "/dev/shm" : fs::temp_directory_path();
  return folder / ("s2gs_fuzz_" + std::to_string(::getpid()) + "_" + name);
}

}  // namespace s2gs
