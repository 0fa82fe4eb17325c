// Names of images from every file that has any, and to every function that makes files of them: nothing that
// was there before may change.

#include "tests/support/hostile_names.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "mesh/io/dense_workspace.h"
#include "plugin/outputs/split_overlay.h"
#include "plugin/stage/split_labels.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/printable.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/scene/scene_truth.h"
#include "tests/plugin/commands/split_fixture.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr char kPlaceholder[] = "PLACEHOLDER.jpg";  // no file but these tests' has it

bool IsRefused(const std::function<void()>& read) {
  try {
    read();
  } catch (const UserError&) {
    return true;
  }
  return false;
}

std::string Replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos);
  return text.replace(at, from.size(), to);
}

ColmapModel ModelWith(const std::string& name) {
  ColmapModel model;
  model.cameras[1] = {1, CameraModelId::kPinhole, 16, 12, {20, 20, 8, 6}};
  model.images[1] = {1, name, 1, {}, {}};
  return model;
}

Json TruthWith(const std::string& name) {
  const Json identity = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
  return {{"scene", "s"},
          {"units", "metres"},
          {"width", 16},
          {"height", 12},
          {"camera_model", "PINHOLE"},
          {"pixel_convention", "COLMAP"},
          {"fx", 20},
          {"fy", 20},
          {"cx", 8},
          {"cy", 6},
          {"axis_point", {0, 0, 0}},
          {"axis_direction", {0, 0, 1}},
          {"mask_values", {{"object", 255}, {"disc", 128}, {"static", 0}}},
          {"images",
           {{{"file", name},
             {"split", "train"},
             {"station", 0},
             {"angle_deg", 0},
             {"world_to_camera", identity},
             {"object_to_world", identity}}}}};
}

// A reader of a file in which an image has this name; throws UserError where it refuses it.
using Reader = std::function<void(const fs::path& folder, const std::string& name)>;

// The name put in by its bytes: the project's writers would not write it.
void WriteModelWith(const fs::path& folder, const std::string& name, ColmapFormat format) {
  fs::create_directories(folder);
  WriteColmapModel(folder, ModelWith(kPlaceholder), format);
  const fs::path images = folder / (format == ColmapFormat::kBinary ? "images.bin" : "images.txt");
  WriteAll(images, Replaced(ReadAll(images), kPlaceholder, name));
}

std::map<std::string, Reader> Readers() {
  std::map<std::string, Reader> readers;
  readers["binary model"] = [](const fs::path& folder, const std::string& name) {
    WriteModelWith(folder, name, ColmapFormat::kBinary);
    ReadColmapModel(folder);
  };
  readers["text model"] = [](const fs::path& folder, const std::string& name) {
    WriteModelWith(folder, name, ColmapFormat::kText);
    ReadColmapModel(folder);
  };
  readers["database"] = [](const fs::path& folder, const std::string& name) {
    WriteSplitFixture(folder / "database.db", {name.empty() ? std::string("x") : name, "b.jpg", "c.jpg"});
    ColmapDatabase::Open(folder / "database.db", ColmapDatabase::Access::kReadOnly).ReadImages();
  };
  readers["turntable.json"] = [](const fs::path& folder, const std::string& name) {
    TurntableFile file;
    file.num_stations = 1;
    file.images.push_back({kPlaceholder, 0, 0, Rigid3()});
    WriteTurntableFile(folder / "turntable.json", file);
    Json json = Json::parse(ReadAll(folder / "turntable.json"));
    json["images"][0]["name"] = name;
    WriteAll(folder / "turntable.json", json.dump(1, ' ', false, Json::error_handler_t::ignore));
    ReadTurntableFile(folder / "turntable.json");
  };
  readers["labels.json"] = [](const fs::path& /*folder*/, const std::string& name) {
    const Json image = {{"name", name}, {"station", 0}, {"labels", ""}};
    const Json json = {{"case", "turntable"}, {"images", Json::array({image})}};
    ParseSplitLabels(json.dump(1, ' ', false, Json::error_handler_t::ignore), "labels.json");
  };
  readers["scene.json"] = [](const fs::path& /*folder*/, const std::string& name) {
    ParseSceneTruth(TruthWith(name).dump(1, ' ', false, Json::error_handler_t::ignore), "scene.json");
  };
  return readers;
}

// JSON cannot hold what is no UTF-8, and lines cannot hold line breaks or the spaces around words: the file
// then has another name.
bool CanHold(const std::string& reader, const std::string& name) {
  if (reader == "text model") {
    return name.find('\n') == std::string::npos &&
           (name.empty() || (name.front() != ' ' && name.back() != ' '));
  }
  const bool is_json = reader.find(".json") != std::string::npos;
  const bool is_utf8 =
      Printable(name).find("\\xf") == std::string::npos && Printable(name).find("\\xc0") == std::string::npos;
  if (is_json) return is_utf8;
  return reader != "database" || !name.empty();
}

TEST(HostileNamesBadInput, EveryReaderRefusesThem) {
  for (const auto& [what, read] : Readers()) {
    TemporaryFolder folder;
    EXPECT_FALSE(IsRefused([&, r = read] { r(folder.path(), "sub/good name.jpg"); })) << what;
    int num_names = 0;
    for (const std::string& name : HostileNames()) {
      if (!CanHold(what, name)) continue;
      ++num_names;
      EXPECT_TRUE(IsRefused([&, r = read, n = name] { r(folder.path(), n); }))
          << what << ": " << Printable(name);
    }
    EXPECT_GE(num_names, 19) << what;
  }
}

// All files below a folder with their contents.
std::map<std::string, std::string> Contents(const fs::path& folder) {
  std::map<std::string, std::string> contents;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) contents[entry.path().string()] = ReadAll(entry.path());
  }
  return contents;
}

class HostileNamesToWriters : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* name : {"originals/a.jpg", "originals/sub/a.jpg"}) {
      fs::create_directories((folder_ / name).parent_path());
      WriteImage(folder_ / name, Image8{16, 12, 3, std::vector<uint8_t>(16 * 12 * 3, 99)});
    }
    before_ = Contents(folder_.path());
  }
  // What was there is there still.
  void ExpectUntouched() const {
    const std::map<std::string, std::string> now = Contents(folder_.path());
    for (const auto& [path, content] : before_) {
      const auto found = now.find(path);
      ASSERT_NE(found, now.end()) << path;
      EXPECT_TRUE(found->second == content) << path;
    }
  }
  // Nothing lies outside the folder that is written but what was there.
  void ExpectNothingOutside(const fs::path& written) const {
    for (const auto& [path, content] : Contents(folder_.path())) {
      const bool is_inside = path.compare(0, written.string().size() + 1, written.string() + "/") == 0;
      EXPECT_TRUE(is_inside || before_.count(path) > 0) << path;
    }
  }

  TemporaryFolder folder_;
  std::map<std::string, std::string> before_;
  Reporter silent_;
};

TEST_F(HostileNamesToWriters, DenseWorkspace) {
  std::vector<std::string> names = HostileNames();
  names.push_back((folder_ / "originals/a.jpg").string());
  names.push_back("../originals/a.jpg");
  for (const std::string& name : names) {
    EXPECT_TRUE(IsRefused([&] {
      WriteDenseWorkspace(folder_ / "scan", ModelWith(name), {"model", folder_ / "originals", {}, {}},
                          silent_);
    })) << Printable(name);
  }
  ExpectUntouched();
  ExpectNothingOutside(folder_ / "scan");
}

TEST_F(HostileNamesToWriters, DenseWorkspaceOverItsOwnPhotos) {
  // The photos are those of the dense workspace itself, straight or by a link.
  fs::create_directories(folder_ / "scan/images");
  fs::copy_file(folder_ / "originals/a.jpg", folder_ / "scan/images/a.jpg");
  before_ = Contents(folder_.path());
  const ColmapModel model = ModelWith("a.jpg");
  EXPECT_TRUE(IsRefused([&] {
    WriteDenseWorkspace(folder_ / "scan", model, {"model", folder_ / "scan/images", {}, {}}, silent_);
  }));
  fs::create_directories(folder_ / "scan2");
  fs::create_directory_symlink(folder_ / "originals", folder_ / "scan2/images");
  EXPECT_TRUE(IsRefused([&] {
    WriteDenseWorkspace(folder_ / "scan2", model, {"model", folder_ / "originals", {}, {}}, silent_);
  }));
  ExpectUntouched();
}

TEST_F(HostileNamesToWriters, Overlays) {
  SplitFeatures features;
  MotionSplit split;
  std::vector<std::string> names = HostileNames();
  names.push_back((folder_ / "originals/a.jpg").string());
  names.push_back("sub/../a.jpg");
  for (const std::string& name : names) {
    SplitImage image;
    image.name = name;
    image.size = {16, 12};
    image.keypoints = {{3, 4}};
    features.images.push_back(image);
    split.labels.push_back({KeypointLabel::kRotating});
  }
  const int num_images = static_cast<int>(features.images.size());
  EXPECT_EQ(
      WriteSplitOverlays(folder_ / "overlays", folder_ / "originals", features, split, num_images, silent_),
      0);
  // Over the photos themselves.
  features.images.front().name = "a.jpg";
  EXPECT_EQ(
      WriteSplitOverlays(folder_ / "originals", folder_ / "originals", features, split, num_images, silent_),
      0);
  EXPECT_EQ(
      WriteSplitOverlays(folder_ / "overlays", folder_ / "originals", features, split, num_images, silent_),
      1);
  ExpectUntouched();
  ExpectNothingOutside(folder_ / "overlays");
}

}  // namespace
}  // namespace s2gs
