#include "plugin/outputs/split_files.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "plugin/stage/scan_input.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "tests/plugin/commands/split_fixture.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

class WarningCounter : public Reporter {
 public:
  void Log(LogLevel level, std::string_view message) override {
    if (level == LogLevel::kWarning) warnings.emplace_back(message);
  }
  std::vector<std::string> warnings;
};

class SplitFiles : public testing::Test {
 protected:
  void Make(const std::vector<std::string>& names,
            const std::function<void(ColmapDatabase&)>& more = nullptr) const {
    WriteSplitFixture(path_, names, more);
  }

  const TemporaryFolder folder_;
  const std::filesystem::path path_ = folder_ / "database.db";
  WarningCounter reporter_;
};

TEST_F(SplitFiles, ReadsInNaturalOrder) {
  Make({"a10.jpg", "a9.jpg", "sub/b.jpg"}, [](ColmapDatabase& database) {
    KeypointMatrix with_scale(2, 4);
    with_scale << 1, 2, 7, 0.5, 3, 4, NAN, 0;
    database.WriteKeypoints(1, with_scale);
    KeypointMatrix with_shape(2, 6);
    with_shape << 1, 2, 3, 0, 0, 12, 3, 4, 0, -2, 2, 0;
    database.WriteKeypoints(2, with_shape);
  });
  const SplitFeatures features = ReadSplitFeatures(path_);
  ASSERT_EQ(features.images.size(), 3U);
  EXPECT_EQ(features.images[0].name, "a9.jpg");
  EXPECT_EQ(features.images[1].name, "a10.jpg");
  EXPECT_EQ(features.images[2].name, "sub/b.jpg");
  EXPECT_EQ(features.rows[1].image_id, 1U);
  EXPECT_EQ(features.images[1].keypoints[1], Eigen::Vector2f(3, 4));
  EXPECT_EQ(features.images[1].size, Eigen::Vector2i(kFixtureWidth, kFixtureHeight));
  EXPECT_EQ(features.images[1].scales, (std::vector<float>{7, 0}));  // not a number becomes the smallest
  EXPECT_EQ(features.images[0].scales, (std::vector<float>{6, 2}));  // the root of the shape's determinant
  EXPECT_EQ(features.images[2].scales, (std::vector<float>{1, 1}));
  ASSERT_EQ(features.images[2].descriptors.size(), 256U);
  EXPECT_EQ(features.images[2].descriptors[128], 3 + 1);  // image 3, keypoint 1
}

TEST_F(SplitFiles, WhatCannotBeSplitIsRefused) {
  const auto read = [&] { ReadSplitFeatures(path_); };
  Make({"a.jpg", "b.jpg"});
  ExpectUserError(read, {path_.string(), "has 2 images", "at least three"});
  Make({"a.jpg", "b.jpg", "c.jpg"},
       [](ColmapDatabase& database) { database.WriteDescriptors(2, DescriptorMatrix::Zero(1, 128)); });
  ExpectUserError(read, {path_.string(), "b.jpg has 2 keypoints but 1 descriptors"});
}

TEST_F(SplitFiles, GivenMatchesFollowTheImagesOrder) {
  Make({"a10.jpg", "a9.jpg", "sub/b.jpg"}, [](ColmapDatabase& database) {
    database.WriteMatches(1, 2, {{0, 1}});
    database.WriteMatches(2, 3, {{1, 0}, {0, 1}});
  });
  const GivenMatches given = ReadGivenMatches(path_, ReadSplitFeatures(path_));
  // a9.jpg, the first image, is the database's second.
  const auto indices = [](const FeatureMatches& matches) {
    std::vector<std::pair<uint32_t, uint32_t>> pairs;
    for (const FeatureMatch& match : matches) pairs.emplace_back(match.point2D_idx1, match.point2D_idx2);
    return pairs;
  };
  using Pairs = std::vector<std::pair<uint32_t, uint32_t>>;
  ASSERT_EQ(given.size(), 2U);
  EXPECT_EQ(indices(given.at({0, 1})), (Pairs{{1, 0}}));
  EXPECT_EQ(indices(given.at({0, 2})), (Pairs{{1, 0}, {0, 1}}));
}

TEST_F(SplitFiles, MatchesAskedForButNotThereAreRefused) {
  Make({"a10.jpg", "a9.jpg", "sub/b.jpg"});
  ExpectUserError([&] { ReadGivenMatches(path_, ReadSplitFeatures(path_)); },
                  {path_.string(), "has no matches"});
}

TEST_F(SplitFiles, MasksGiveLabels) {
  Make({"a.jpg", "sub/b.jpg", "c.jpg"});
  SplitFeatures features = ReadSplitFeatures(path_);
  Image8 mask{kFixtureWidth, kFixtureHeight, 1, std::vector<uint8_t>(kFixtureWidth * kFixtureHeight, 0)};
  *mask.Pixel(3, 4) = 1;  // the second keypoint's; the first lies at (1, 2)
  std::filesystem::create_directories(folder_ / "masks/sub");
  WriteImage(folder_ / "masks/a.jpg.png", mask);
  WriteImage(folder_ / "masks/sub/b.png", mask);
  ApplyMasks(folder_ / "masks", &features, reporter_);
  const std::vector<KeypointLabel> expected = {KeypointLabel::kStatic, KeypointLabel::kRotating};
  const std::vector<KeypointLabel> none(2, KeypointLabel::kUnknown);
  for (const SplitImage& image : features.images)
    EXPECT_EQ(image.given_labels, image.name == "c.jpg" ? none : expected) << image.name;
  ASSERT_EQ(reporter_.warnings.size(), 1U);
  EXPECT_EQ(reporter_.warnings[0].substr(0, 20), "1 photos have no mas");
}

TEST_F(SplitFiles, MasksThatDoNotFitAreRefused) {
  Make({"a.jpg", "b.jpg", "c.jpg"});
  SplitFeatures features = ReadSplitFeatures(path_);
  ExpectUserError([&] { ApplyMasks(folder_ / "masks", &features, reporter_); },
                  {(folder_ / "masks").string(), "no mask for any", "a.jpg.png"});
  std::filesystem::create_directories(folder_ / "masks");
  WriteImage(folder_ / "masks/b.jpg.png", Image8{5, 4, 1, std::vector<uint8_t>(20, 0)});
  features = ReadSplitFeatures(path_);
  ExpectUserError([&] { ApplyMasks(folder_ / "masks", &features, reporter_); },
                  {(folder_ / "masks/b.jpg.png").string(), "is 5 x 4 pixels, its photo 16 x 12"});
}

// The copy has the pairs given and nothing else of the kind; what it was copied from stays as it was.
TEST_F(SplitFiles, DatabaseOfOneBody) {
  Make({"b.jpg", "a.jpg", "c.jpg"}, [](ColmapDatabase& database) {
    TwoViewGeometry old;
    old.config = TwoViewConfig::kUncalibrated;
    old.F = Eigen::Matrix3d::Identity();
    old.inlier_matches = {{0, 0}, {1, 1}};
    database.WriteTwoViewGeometry(1, 3, old);
  });
  const std::string before = ReadAll(path_);
  const SplitFeatures features = ReadSplitFeatures(path_);
  VerifiedPair pair;  // a.jpg and b.jpg: ids 2 and 1
  pair.image1 = 0;
  pair.image2 = 1;
  pair.matches = {{0, 1}};
  pair.F << 1, 2, 3, 4, 5, 6, 7, 8, 10;
  pair.H << 2, 0, 0, 0, 2, 0, 0, 0, 1;
  pair.is_planar = true;
  const std::vector<ImagePairMatches> matches = {{0, 1, {{0, 1}, {1, 0}}}};
  const std::filesystem::path copy_path = folder_ / "object.db";
  WriteSplitDatabase(path_, copy_path, features, {pair}, matches, reporter_);
  EXPECT_EQ(ReadAll(path_), before);
  const ColmapDatabase copy = ColmapDatabase::Open(copy_path, ColmapDatabase::Access::kReadOnly);
  EXPECT_FALSE(copy.ReadTwoViewGeometry(1, 3).has_value());
  const auto geometry = copy.ReadTwoViewGeometry(2, 1);
  ASSERT_TRUE(geometry.has_value());
  EXPECT_EQ(geometry->config, TwoViewConfig::kUncalibrated);
  ASSERT_EQ(geometry->inlier_matches.size(), 1U);
  EXPECT_EQ(geometry->inlier_matches[0].point2D_idx1, 0U);
  EXPECT_EQ(geometry->inlier_matches[0].point2D_idx2, 1U);
  EXPECT_TRUE(geometry->F->isApprox(pair.F));
  EXPECT_TRUE(geometry->H->isApprox(pair.H));
  // A pair whose points are no plane has none.
  VerifiedPair solid = pair;
  solid.is_planar = false;
  WriteSplitDatabase(path_, folder_ / "solid.db", features, {solid}, matches, reporter_);
  EXPECT_FALSE(ColmapDatabase::Open(folder_ / "solid.db", ColmapDatabase::Access::kReadOnly)
                   .ReadTwoViewGeometry(2, 1)
                   ->H.has_value());
  EXPECT_EQ(copy.ReadMatches(2, 1).size(), 2U);
  EXPECT_EQ(copy.NumKeypoints(3), 2U);
  WriteSplitDatabase(path_, copy_path, features, {pair}, {}, reporter_);
  EXPECT_FALSE(ColmapDatabase::Open(copy_path, ColmapDatabase::Access::kReadOnly).HasMatches(1, 2));
}

TEST_F(SplitFiles, BackgroundsOfStationsStandAfterTheOwnKeypoints) {
  Make({"b.jpg", "a.jpg", "c.jpg"});
  SplitFeatures features = ReadSplitFeatures(path_);
  const std::vector<uint8_t> own = features.images[1].descriptors;
  MotionSplit split;
  split.labels.assign(3, {KeypointLabel::kRotating, KeypointLabel::kUnknown});
  StationFeatures merged;
  merged.image = 1;
  merged.keypoints = {{7.25F, 8.5F}};
  merged.scales = {3};
  merged.descriptors.assign(kDescriptorSize, 45);
  split.station_features = {merged};
  AppendStationFeatures(&split, &features);
  EXPECT_EQ(split.labels[0].size(), 2U);
  EXPECT_EQ(split.labels[1], (std::vector<KeypointLabel>{KeypointLabel::kRotating, KeypointLabel::kUnknown,
                                                         KeypointLabel::kStatic}));
  const std::filesystem::path copy_path = folder_.path() / "copy.db";
  WriteSplitDatabase(path_, copy_path, features, {}, {}, reporter_);
  const ColmapDatabase copy = ColmapDatabase::Open(copy_path, ColmapDatabase::Access::kReadOnly);
  const KeypointMatrix keypoints = copy.ReadKeypoints(features.rows[1].image_id);
  ASSERT_EQ(keypoints.rows(), 3);
  EXPECT_EQ(keypoints(2, 0), 7.25F);
  EXPECT_EQ(keypoints(2, 1), 8.5F);
  const DescriptorMatrix descriptors = copy.ReadDescriptors(features.rows[1].image_id);
  ASSERT_EQ(descriptors.rows(), 3);
  EXPECT_TRUE(std::equal(own.begin(), own.end(), descriptors.data()));
  EXPECT_EQ(descriptors(2, 127), 45);
  EXPECT_EQ(copy.NumKeypoints(features.rows[0].image_id), 2U);
}

// A photo's keypoints have two, four or six columns: what is added has as many.
TEST_F(SplitFiles, WhatIsAddedHasAsManyColumnsAsTheOthers) {
  Make({"a.jpg", "b.jpg", "c.jpg"}, [](ColmapDatabase& database) {
    database.WriteKeypoints(2, KeypointMatrix::Ones(2, 4));
    database.WriteKeypoints(3, KeypointMatrix::Ones(2, 6));
  });
  SplitFeatures features = ReadSplitFeatures(path_);
  SiftFeatures more;
  more.keypoints = {{7.25F, 8.5F}};
  more.scales = {3};
  more.orientations = {0.5F};
  more.descriptors.assign(kDescriptorSize, 45);
  features.added.assign(3, more);
  for (SplitImage& image : features.images) {
    image.keypoints.push_back(more.keypoints[0]);
    image.descriptors.insert(image.descriptors.end(), more.descriptors.begin(), more.descriptors.end());
  }
  const std::filesystem::path copy_path = folder_.path() / "copy.db";
  WriteSplitDatabase(path_, copy_path, features, {}, {}, reporter_);
  const ColmapDatabase copy = ColmapDatabase::Open(copy_path, ColmapDatabase::Access::kReadOnly);
  const float c = 3 * std::cos(0.5F);
  const float s = 3 * std::sin(0.5F);
  const std::vector<std::vector<float>> expected = {
      {7.25F, 8.5F}, {7.25F, 8.5F, 3, 0.5F}, {7.25F, 8.5F, c, -s, s, c}};
  for (uint32_t id = 1; id <= 3; ++id) {
    const KeypointMatrix keypoints = copy.ReadKeypoints(id);
    ASSERT_EQ(keypoints.rows(), 3) << id;
    ASSERT_EQ(keypoints.cols(), static_cast<Eigen::Index>(expected[id - 1].size())) << id;
    for (Eigen::Index k = 0; k < keypoints.cols(); ++k)
      EXPECT_FLOAT_EQ(keypoints(2, k), expected[id - 1][static_cast<size_t>(k)]) << id << " " << k;
  }
}

TEST_F(SplitFiles, LabelsComeBack) {
  const Workspace workspace{folder_.path()};
  Make({"b.jpg", "a.jpg", "c\xC3\xA9.jpg"});
  const SplitFeatures features = ReadSplitFeatures(path_);
  MotionSplit split;
  split.capture_case = CaptureCase::kSingleStation;
  split.reason = "one \"station\"";
  split.warnings = {"a warning"};
  split.stations.station_of_image = {0, 1, 0};
  split.stations.images = {{0, 2}, {1}};
  split.stations.photo_from_first.assign(3, Eigen::Matrix3d::Identity());
  split.stations.photo_from_first[2] << 1, 0.002, -1.5, -0.003, 1, 0.1, 1e-6, 0, 1;
  split.representative = {2, 1};
  split.labels = {{KeypointLabel::kStatic, KeypointLabel::kRotating},
                  {KeypointLabel::kUnknown, KeypointLabel::kUnknown},
                  {KeypointLabel::kRotating, KeypointLabel::kUnknown}};
  std::filesystem::create_directories(workspace.SplitLabels().parent_path());
  WriteSplitDatabase(path_, workspace.ObjectDatabase(), features, {}, {}, reporter_);
  WriteLabels(workspace.SplitLabels(), split, features);
  const ScanInput input = ReadScanInput(workspace);
  EXPECT_EQ(input.capture_case, CaptureCase::kSingleStation);
  EXPECT_EQ(input.reason, split.reason);
  ASSERT_EQ(input.features.images.size(), 3U);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(input.features.images[i].name, features.images[i].name);
    EXPECT_EQ(input.features.images[i].labels, split.labels[i]);
    EXPECT_EQ(input.features.images[i].station, split.stations.station_of_image[i]);
    EXPECT_EQ(input.features.images[i].photo_from_first, split.stations.photo_from_first[i]);
  }
  const auto file = nlohmann::json::parse(ReadAll(workspace.SplitLabels()));
  EXPECT_EQ(file.at("warnings"), nlohmann::json(split.warnings));
  EXPECT_EQ(file.at("num_stations"), 2);
  EXPECT_FALSE(file.at("images")[0].at("represents_station"));
  EXPECT_TRUE(file.at("images")[1].at("represents_station"));
  EXPECT_TRUE(file.at("images")[2].at("represents_station"));
  EXPECT_FALSE(file.at("images")[0].contains("photo_from_first"));  // a camera that stood still
}

}  // namespace
}  // namespace s2gs
