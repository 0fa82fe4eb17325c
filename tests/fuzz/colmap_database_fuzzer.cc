// COLMAP databases: opening and reading everything.

#include <sqlite3.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scratch_path.h"

namespace {

namespace fs = std::filesystem;
using s2gs::ColmapDatabase;
using s2gs::ScratchPath;

std::string Content(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

// Small pages, so that a small file has many kinds of them.
void SetPageSize(const fs::path& path, const char* more) {
  sqlite3* handle = nullptr;
  sqlite3_open(path.c_str(), &handle);
  sqlite3_exec(handle, (std::string("PRAGMA page_size=512; VACUUM;") + more).c_str(), nullptr, nullptr,
               nullptr);
  sqlite3_close(handle);
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  const fs::path path = ScratchPath("seed.db");
  fs::remove(path);
  ColmapDatabase::WriteAtomically(path, [](ColmapDatabase& database) {
    database.WriteCamera({{1, s2gs::CameraModelId::kSimplePinhole, 10, 20, {1, 2, 3}}, true});
    for (const uint32_t id : {1u, 2u, 3u}) {
      database.WriteImage({id, std::to_string(id), 1, {}, {}});
      database.WriteKeypoints(id, s2gs::KeypointMatrix::Ones(4, 6));
      database.WriteDescriptors(id, s2gs::DescriptorMatrix::Ones(4, 128));
    }
    s2gs::TwoViewGeometry geometry;
    geometry.inlier_matches = {{0, 1}, {2, 3}};
    geometry.F = geometry.E = geometry.H = Eigen::Matrix3d::Identity();
    geometry.cam2_from_cam1 = s2gs::Rigid3{Eigen::Quaterniond(0.5, 0.5, 0.5, 0.5), Eigen::Vector3d::Ones()};
    for (const auto& [id1, id2] : {std::pair(1u, 2u), std::pair(3u, 1u), std::pair(2u, 3u)}) {
      database.WriteMatches(id1, id2, geometry.inlier_matches);
      database.WriteTwoViewGeometry(id1, id2, geometry);
    }
  });
  SetPageSize(path, "");
  std::vector<std::string> seeds = {Content(path)};
  SetPageSize(path,
              "ALTER TABLE descriptors ADD COLUMN type INTEGER NOT NULL DEFAULT 0; PRAGMA journal_mode=WAL;");
  seeds.push_back(Content(path));
  fs::remove(path);
  return seeds;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const fs::path path = ScratchPath("input.db");
  {
    std::ofstream stream(path, std::ios::binary | std::ios::trunc);
    stream.write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  }
  try {
    const ColmapDatabase database = ColmapDatabase::Open(path, ColmapDatabase::Access::kReadOnly);
    // Each part by itself: a fault in one must not hide the next.
    const auto try_to = [](const auto& read) {
      try {
        read();
      } catch (const s2gs::UserError&) {
      }
    };
    try_to([&] { database.ReadImages(); });
    for (const uint32_t id : {1u, 2u, 3u}) {
      try_to([&] { database.ReadKeypoints(id); });
      try_to([&] { database.ReadDescriptors(id); });
      try_to([&] { database.ReadTwoViewGeometry(id, id % 3 + 1); });
    }
    try_to([&] { database.ForEachMatches([](uint32_t, uint32_t, const s2gs::FeatureMatches&) {}); });
    try_to([&] { database.ForEachTwoViewGeometry([](uint32_t, uint32_t, const s2gs::TwoViewGeometry&) {}); });
  } catch (const s2gs::UserError&) {
  }
  fs::remove(path);
  return 0;
}
