#include "plugin/stage/scan_input.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using nlohmann::json;

// Three images of two keypoints each, one verified pair of the object.
class ScanInputTest : public testing::Test {
 protected:
  void SetUp() override {
    std::filesystem::create_directories(workspace_.ObjectDatabase().parent_path());
    ColmapDatabase::WriteAtomically(workspace_.ObjectDatabase(), [&](ColmapDatabase& database) {
      Camera camera;
      camera.camera_id = 1;
      camera.model = CameraModelId::kSimplePinhole;
      camera.width = 64;
      camera.height = 48;
      camera.params = {70, 32, 24};
      database.WriteCamera({camera, true});
      KeypointMatrix keypoints(2, 2);
      keypoints << 1, 2, 3, 4;
      for (const char* name : {"a.jpg", "b.jpg", "c.jpg"}) {
        DatabaseImage row;
        row.name = name;
        row.camera_id = 1;
        database.WriteKeypoints(database.WriteImage(row), keypoints);
      }
      TwoViewGeometry geometry;
      geometry.config = TwoViewConfig::kUncalibrated;
      geometry.F = Eigen::Matrix3d::Identity();
      geometry.inlier_matches = {{1, 0}};
      database.WriteTwoViewGeometry(1, 3, geometry);
      database.WriteMatches(1, 2, {{0, 1}, {1, 0}});
    });
    WriteLabelsFile(Labels());
  }

  static json Labels() {
    json images = json::array();
    for (const char* name : {"a.jpg", "b.jpg", "c.jpg"}) {
      images.push_back({{"name", name}, {"station", name[0] == 'c' ? 1 : 0}, {"labels", "21"}});
    }
    return {{"case", "single_station"}, {"reason", "a test"}, {"images", images}};
  }
  void WriteLabelsFile(const json& content) const { WriteLabelsText(content.dump()); }
  void WriteLabelsText(const std::string& text) const { WriteAll(workspace_.SplitLabels(), text); }
  void ExpectRefused(const json& labels, const std::string& why) const {
    WriteLabelsFile(labels);
    ExpectUserError([&] { ReadScanInput(workspace_); }, {workspace_.SplitLabels().string(), why},
                    labels.dump());
  }

  const TemporaryFolder folder_;
  const Workspace workspace_{folder_.path()};
};

TEST_F(ScanInputTest, ReadsLabelsStationsAndMatches) {
  const ScanInput input = ReadScanInput(workspace_);
  EXPECT_EQ(input.capture_case, CaptureCase::kSingleStation);
  EXPECT_EQ(input.reason, "a test");
  const ScanFeatures& features = input.features;
  ASSERT_EQ(features.images.size(), 3U);
  EXPECT_EQ(features.images[2].name, "c.jpg");
  EXPECT_EQ(features.images[1].station, 0);
  EXPECT_EQ(features.images[2].station, 1);
  EXPECT_EQ(features.images[0].labels,
            (std::vector<KeypointLabel>{KeypointLabel::kRotating, KeypointLabel::kStatic}));
  EXPECT_EQ(features.images[0].keypoints[1], Eigen::Vector2f(3, 4));
  ASSERT_EQ(features.object_pairs.size(), 1U);
  EXPECT_EQ(features.object_pairs[0].image1, 0);
  EXPECT_EQ(features.object_pairs[0].image2, 2);
  ASSERT_EQ(features.object_pairs[0].matches.size(), 1U);
  EXPECT_EQ(features.object_pairs[0].matches[0].point2D_idx1, 1U);
  EXPECT_EQ(features.raw_pairs.size(), 1U);
  EXPECT_TRUE(features.static_pairs.empty());
  EXPECT_TRUE(features.has_prior_focal.at(1));
}

// The split writes images as the table turned, whatever they are called; matches go along.
TEST_F(ScanInputTest, ImagesComeInTheOrderOfTheLabels) {
  json labels = Labels();
  std::swap(labels["images"][0], labels["images"][2]);
  WriteLabelsFile(labels);
  const ScanFeatures features = ReadScanInput(workspace_).features;
  ASSERT_EQ(features.images.size(), 3U);
  EXPECT_EQ(features.images[0].name, "c.jpg");
  EXPECT_EQ(features.images[2].name, "a.jpg");
  ASSERT_EQ(features.object_pairs.size(), 1U);
  EXPECT_EQ(features.object_pairs[0].image1, 0);
  EXPECT_EQ(features.object_pairs[0].image2, 2);
  ASSERT_EQ(features.object_pairs[0].matches.size(), 1U);
  EXPECT_EQ(features.object_pairs[0].matches[0].point2D_idx1, 0U);
  EXPECT_EQ(features.object_pairs[0].matches[0].point2D_idx2, 1U);
}

TEST_F(ScanInputTest, LabelsAreReplacedAndTheRestKept) {
  const ScanInput input = ReadScanInput(workspace_);
  std::vector<std::vector<KeypointLabel>> labels(3, {KeypointLabel::kUnknown, KeypointLabel::kRotating});
  labels[1] = {KeypointLabel::kStatic, KeypointLabel::kStatic};
  WriteScanLabels(workspace_, input.features.images, labels);
  json expected = Labels();
  for (json& image : expected["images"]) image["split_labels"] = image["labels"];
  expected["images"][0]["labels"] = expected["images"][2]["labels"] = "02";
  expected["images"][1]["labels"] = "11";
  EXPECT_EQ(json::parse(ReadAll(workspace_.SplitLabels())), expected);
  // What is read again, for another mapping, are the split's own labels.
  const ScanInput again = ReadScanInput(workspace_);
  for (size_t i = 0; i < 3; ++i) EXPECT_EQ(again.features.images[i].labels, input.features.images[i].labels);
}

TEST_F(ScanInputTest, ContradictionsAreUserErrors) {
  const auto with = [](const char* key, const json& value) {
    json labels = Labels();
    labels["images"][1][key] = value;
    return labels;
  };
  ExpectRefused({{"images", json::array()}}, "does not know image a.jpg");
  ExpectRefused(with("name", "other.jpg"), "does not know image b.jpg");
  ExpectRefused(with("name", "a.jpg"), "has image a.jpg twice");
  ExpectRefused(with("name", 3), "is damaged");
  for (const json& station : {json(-1), json(3), json(1LL << 40), json(1e300), json(0.5), json("0"), json()})
    ExpectRefused(with("station", station), "a station that cannot be");
  for (const json& shake : {json{1, 0, 0}, json{0, 0, 0, 0, 0, 0, 0, 0, 0}, json{1, 0, 0, 0, -1, 0, 0, 0, 1},
                            json{1, 0, 1e308, 0, 1e308, 0, 1e308, 0, 1}}) {
    ExpectRefused(with("photo_from_first", shake), "a shake that cannot be");
  }
  ExpectRefused(with("photo_from_first", "shaken"), "is damaged");
  for (const char* text : {"", "2", "210", "2x", "23"}) ExpectRefused(with("labels", text), "do not fit");
  ExpectRefused(with("labels", 21), "is damaged");
  json other_case = Labels();
  other_case["case"] = "else";
  ExpectRefused(other_case, "unknown case \"else\"");
  ExpectRefused({{"case", "turntable"}}, "is damaged");
  ExpectRefused(json::array(), "is damaged");
  std::filesystem::remove(workspace_.SplitLabels());
  ExpectUserError([&] { ReadScanInput(workspace_); }, {workspace_.SplitLabels().string(), "motion_splitter"});
}

using LabelsBadInput = ScanInputTest;

TEST_F(LabelsBadInput, NeverCrashes) {
  const std::string path = workspace_.root.string();
  int num_accepted = 0;
  ForEachDamage(Labels().dump(), [&](const std::string& damaged, const std::string& description) {
    WriteLabelsText(damaged);
    const ScopedAllocationLimit limit(size_t{1} << 20);
    if (!ExpectOkOrUserError([&] { ReadScanInput(workspace_); }, path, description)) return;
    ++num_accepted;
    ExpectOkOrUserError(
        [&] {
          const std::vector<std::vector<KeypointLabel>> labels(
              3, {KeypointLabel::kStatic, KeypointLabel::kStatic});
          WriteScanLabels(workspace_, ReadScanInput(workspace_).features.images, labels);
        },
        path, description);
  });
  EXPECT_GT(num_accepted, 0);  // a flipped bit of the reason
  for (const char* text :
       {"", "null", "[[[[[[", "{\"images\": {\"a\": 1}}", "\xFF\xFE", "{\"images\": 1e999}"}) {
    WriteLabelsText(text);
    ExpectUserError([&] { ReadScanInput(workspace_); }, {path}, text);
  }
  WriteLabelsText(std::string(100000, '['));
  ExpectUserError([&] { ReadScanInput(workspace_); }, {path});
  std::string deep = Labels().dump();
  deep.insert(1, "\"more\":" + std::string(100000, '[') + std::string(100000, ']') + ",");
  WriteLabelsText(deep);
  ExpectUserError([&] { ReadScanInput(workspace_); }, {path, "nested too deeply"});
}

}  // namespace
}  // namespace s2gs
