#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "plugin/stage/workspace.h"
#include "tests/fuzz/scratch_path.h"

namespace s2gs {

inline const Workspace& FuzzedWorkspace() {
  static const Workspace workspace{ScratchPath("scan")};
  return workspace;
}

inline std::vector<std::filesystem::path> FuzzedFiles() {
  const Workspace& w = FuzzedWorkspace();
  return {w.SplitLabels(), w.TurntableMapper(), w.ScanRecord(), w.Log(), w.ReportJson(),
          w.Plan(),        w.Turntable()};
}

inline std::string FileContent(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

/// Writes the input into the file that its first byte chooses, all others being absent.
inline void WriteFuzzedFile(const uint8_t* data, size_t size) {
  const std::vector<std::filesystem::path> files = FuzzedFiles();
  for (const std::filesystem::path& file : files) std::filesystem::remove(file);
  const std::filesystem::path& path = files[data[0] % files.size()];
  std::filesystem::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data) + 1, static_cast<std::streamsize>(size - 1));
}

inline std::vector<std::string> ScanJsonSeeds() {
  return {
      std::string(1, '\0') +
          R"({"case":"turntable","reason":"r","images":[{"name":"a.jpg","station":0,"labels":"012"}]})",
      std::string(1, '\1') +
          R"({"version":1,"case":"turntable","path":"p","path_reason":"r","images":2,"registered":1,"missing":["b"],)"
          R"("seconds":{"read":1},"verdict":{"verdict":"good","reasons":["<script>"],"advice":["y"],"checks":[]},)"
          R"("stations":1,"object":{"points":1,"observations":2,"mean_reprojection_error_px":0.5},)"
          R"("sigma":{"angle_median_deg":0.1},"angle_sigma_deg":{"a.jpg":0.1},"mended":[],"rounds":[]})",
      std::string(1, '\2') + R"({"steps":[{"command":"a","line":"s2gs a","wall_seconds":1,"cpu_seconds":2}],)"
                             R"("stages":[{"name":"a","run":true,"reason":"b","seconds":3}]})",
      std::string(1, '\3') +
          R"({"event":"held_out","psnr_db":30.5,"iteration":5,"count":7,"seconds":1,"loss":0.5})"
          "\n{}\n"};
}

}  // namespace s2gs
