#include "sfm_split/matching/match_images.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/matching/image_similarity.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using ::testing::ElementsAre;

// Stops after so many progress reports, and remembers the last one.
class StoppingReporter : public Reporter {
 public:
  explicit StoppingReporter(int reports_before_stop) : reports_left_(reports_before_stop) {}
  void Progress(std::string_view task, int64_t done, int64_t total) override {
    last_task = task;
    last_done = done;
    last_total = total;
    --reports_left_;
  }
  bool StopRequested() const override { return reports_left_ <= 0; }

  std::string last_task;
  int64_t last_done = -1;
  int64_t last_total = -1;

 private:
  int reports_left_;
};

// Images that share descriptors: image i shows features [40 i, 40 i + 200) of a long strip, with noise.
class MatchImagesTest : public ::testing::Test {
 protected:
  static constexpr int kNumImages = 8;
  static constexpr int kNumFeatures = 200;
  static constexpr int kShift = 40;

  void SetUp() override {
    std::mt19937 rng(1);
    std::gamma_distribution<float> gamma(0.5F);
    std::normal_distribution<float> noise(0.0F, 4.0F);
    constexpr int kStrip = kShift * kNumImages + kNumFeatures;
    Eigen::Matrix<float, Eigen::Dynamic, 128, Eigen::RowMajor> strip(kStrip, 128);
    for (float& value : strip.reshaped()) value = gamma(rng);
    for (int i = 0; i < kStrip; ++i) strip.row(i) = 512.0F * (strip.row(i) / strip.row(i).sum()).cwiseSqrt();

    ColmapDatabase database = ColmapDatabase::Create(path_);
    DatabaseCamera camera;
    camera.camera.model = CameraModelId::kSimplePinhole;
    camera.camera.width = 100;
    camera.camera.height = 100;
    camera.camera.params = {100.0, 50.0, 50.0};
    const uint32_t camera_id = database.WriteCamera(camera);
    for (int i = 0; i < kNumImages; ++i) {
      DatabaseImage image;
      image.name = "image" + std::to_string(i) + ".jpg";
      image.camera_id = camera_id;
      const uint32_t image_id = database.WriteImage(image);
      image_ids_.push_back(image_id);
      KeypointMatrix keypoints(kNumFeatures, 4);
      DescriptorMatrix descriptors(kNumFeatures, 128);
      for (int k = 0; k < kNumFeatures; ++k) {
        keypoints.row(k) << 1.0F, 2.0F, static_cast<float>(1 + (kShift * i + k) % 7), 0.0F;
        for (int d = 0; d < 128; ++d) {
          descriptors(k, d) =
              static_cast<uint8_t>(std::clamp(strip(kShift * i + k, d) + noise(rng), 0.0F, 255.0F));
        }
      }
      database.WriteKeypoints(image_id, keypoints);
      database.WriteDescriptors(image_id, descriptors);
    }
    database.Close();
  }

  static std::vector<ImagePair> AllPairs() {
    std::vector<ImagePair> pairs;
    for (uint32_t i = 0; i < kNumImages; ++i) {
      for (uint32_t j = i + 1; j < kNumImages; ++j) pairs.push_back({i, j});
    }
    return pairs;
  }

  ColmapDatabase OpenDatabase() { return ColmapDatabase::Open(path_, ColmapDatabase::Access::kReadWrite); }

  // What DescriptorMatcher gives for each pair, straight from the descriptors.
  static FeatureMatches Direct(const ColmapDatabase& database, uint32_t image_id1, uint32_t image_id2) {
    const DescriptorMatrix a = database.ReadDescriptors(image_id1);
    const DescriptorMatrix b = database.ReadDescriptors(image_id2);
    FeatureMatches matches;
    DescriptorMatcher({}, 1, MatchInstructions::kPortable)
        .Match(PackedDescriptors(a.data(), a.rows()), PackedDescriptors(b.data(), b.rows()), &matches);
    return matches;
  }

  TemporaryFolder folder_;
  std::filesystem::path path_ = folder_ / "database.db";
  std::vector<uint32_t> image_ids_;
};

TEST_F(MatchImagesTest, WritesTheMatchesTable) {
  ColmapDatabase database = OpenDatabase();
  StoppingReporter reporter(1000);
  const MatchImagesSummary summary = MatchImages(image_ids_, AllPairs(), {}, &database, reporter);
  EXPECT_EQ(summary.num_pairs_matched, 28U);
  EXPECT_EQ(summary.num_pairs_skipped, 0U);
  EXPECT_EQ(summary.num_image_loads, 8U);
  EXPECT_EQ(reporter.last_task, "match pairs");
  EXPECT_EQ(reporter.last_done, 28);
  EXPECT_EQ(reporter.last_total, 28);
  size_t num_matches = 0;
  for (const ImagePair pair : AllPairs()) {
    const uint32_t id1 = image_ids_[pair.first];
    const uint32_t id2 = image_ids_[pair.second];
    ASSERT_TRUE(database.HasMatches(id1, id2));  // also those that share nothing
    const FeatureMatches matches = database.ReadMatches(id1, id2);
    EXPECT_EQ(matches, Direct(database, id1, id2));
    num_matches += matches.size();
    // The shared part of the strip, feature by feature.
    const int shift = kShift * static_cast<int>(pair.second - pair.first);
    EXPECT_EQ(static_cast<int>(matches.size()), std::max(0, kNumFeatures - shift));
    for (const FeatureMatch& match : matches) {
      EXPECT_EQ(static_cast<int>(match.point2D_idx1) - static_cast<int>(match.point2D_idx2), shift);
    }
  }
  EXPECT_EQ(summary.num_matches, num_matches);
}

TEST_F(MatchImagesTest, SmallCacheGivesTheSame) {
  ColmapDatabase database = OpenDatabase();
  Reporter silent;
  MatchImagesOptions options;
  options.cache_size_gb = 1e-4;  // three images
  const MatchImagesSummary summary = MatchImages(image_ids_, AllPairs(), options, &database, silent);
  EXPECT_GT(summary.num_image_loads, 8U);
  EXPECT_LT(summary.num_image_loads, 2U * 28U);
  for (const ImagePair pair : AllPairs()) {
    const uint32_t id1 = image_ids_[pair.first];
    const uint32_t id2 = image_ids_[pair.second];
    EXPECT_EQ(database.ReadMatches(id1, id2), Direct(database, id1, id2));
  }
}

TEST_F(MatchImagesTest, ResumesAfterAStop) {
  ColmapDatabase database = OpenDatabase();
  MatchImagesOptions options;
  options.cache_size_gb = 1e-4;  // small batches, each committed
  StoppingReporter reporter(4);
  EXPECT_THROW(MatchImages(image_ids_, AllPairs(), options, &database, reporter), Interrupted);
  size_t num_done = 0;
  for (const ImagePair pair : AllPairs()) {
    num_done += database.HasMatches(image_ids_[pair.first], image_ids_[pair.second]) ? 1 : 0;
  }
  EXPECT_GT(num_done, 0U);
  EXPECT_LT(num_done, 28U);
  EXPECT_EQ(reporter.last_done, static_cast<int64_t>(num_done));  // what was reported is in the file
  database.Close();

  ColmapDatabase reopened = OpenDatabase();
  Reporter silent;
  const MatchImagesSummary summary = MatchImages(image_ids_, AllPairs(), options, &reopened, silent);
  EXPECT_EQ(summary.num_pairs_skipped, num_done);
  EXPECT_EQ(summary.num_pairs_matched, 28U - num_done);
  for (const ImagePair pair : AllPairs()) {
    const uint32_t id1 = image_ids_[pair.first];
    const uint32_t id2 = image_ids_[pair.second];
    EXPECT_EQ(reopened.ReadMatches(id1, id2), Direct(reopened, id1, id2));
  }
}

TEST_F(MatchImagesTest, LeavesMatchedPairsAsTheyAre) {
  ColmapDatabase database = OpenDatabase();
  const FeatureMatches earlier = {{5, 6}};
  database.WriteMatches(image_ids_[0], image_ids_[1], earlier);
  Reporter silent;
  const MatchImagesSummary summary = MatchImages(image_ids_, {{1, 2}, {0, 1}, {1, 2}}, {}, &database, silent);
  EXPECT_EQ(summary.num_pairs_matched, 1U);
  EXPECT_EQ(summary.num_pairs_skipped, 1U);
  EXPECT_EQ(database.ReadMatches(image_ids_[0], image_ids_[1]), earlier);
  EXPECT_FALSE(database.HasMatches(image_ids_[2], image_ids_[3]));
}

TEST_F(MatchImagesTest, ImagesWithoutFeaturesGetEmptyMatches) {
  ColmapDatabase database = OpenDatabase();
  DatabaseImage image;
  image.name = "empty.jpg";
  image.camera_id = database.ReadImages().front().camera_id;
  image_ids_.push_back(database.WriteImage(image));
  Reporter silent;
  const MatchImagesSummary summary = MatchImages(image_ids_, {{0, kNumImages}}, {}, &database, silent);
  EXPECT_EQ(summary.num_pairs_matched, 1U);
  EXPECT_TRUE(database.HasMatches(image_ids_[0], image_ids_[kNumImages]));
  EXPECT_TRUE(database.ReadMatches(image_ids_[0], image_ids_[kNumImages]).empty());
}

TEST_F(MatchImagesTest, SimilarityCountsMatchesOfTheLargestFeatures) {
  const ColmapDatabase database = OpenDatabase();
  DescriptorMatcher matcher({}, 2);
  Reporter silent;
  const SimilarityMatrix all = CoarseSimilarity(database, image_ids_, kNumFeatures, &matcher, silent);
  const SimilarityMatrix few = CoarseSimilarity(database, image_ids_, 50, &matcher, silent);
  for (int i = 0; i < kNumImages; ++i) {
    for (int j = 0; j < kNumImages; ++j) {
      const int shared = i == j ? 0 : std::max(0, kNumFeatures - kShift * std::abs(i - j));
      EXPECT_EQ(static_cast<int>(all(i, j)), shared);
      // A quarter of the features, the same ones in both images but for the rims of the overlap.
      EXPECT_NEAR(few(i, j), 0.25 * shared, 12.0) << i << " " << j;
    }
  }
  StoppingReporter stop(0);
  EXPECT_THROW(CoarseSimilarity(database, image_ids_, 50, &matcher, stop), Interrupted);
}

TEST(ImageSimilarity, LargestKeypoints) {
  KeypointMatrix scales(5, 4);
  scales << 0, 0, 2, 0, 0, 0, 9, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0, 5, 0;
  EXPECT_THAT(LargestKeypoints(scales, 3), ElementsAre(0, 1, 4));
  EXPECT_THAT(LargestKeypoints(scales, 99), ElementsAre(0, 1, 2, 3, 4));
  KeypointMatrix affine(3, 6);
  affine << 0, 0, 1, 0, 0, 1, 0, 0, 0, -3, 3, 0, 0, 0, 2, 0, 0, 2;
  EXPECT_THAT(LargestKeypoints(affine, 2), ElementsAre(1, 2));
  EXPECT_THAT(LargestKeypoints(KeypointMatrix::Zero(4, 2), 2), ElementsAre(0, 1));
  EXPECT_THAT(LargestKeypoints(KeypointMatrix(0, 6), 2), ElementsAre());
}

TEST(MatchImages, OptionsOutsideTheirBoundsAreNamed) {
  EXPECT_FALSE(MatchImagesOptions{}.Check().has_value());
  MatchImagesOptions options;
  options.match.max_ratio = 2.0;
  EXPECT_EQ(options.Check()->field, "max_ratio");
  options = {};
  options.num_threads = -1;
  EXPECT_EQ(options.Check()->field, "num_threads");
  options = {};
  options.cache_size_gb = 0.0;
  EXPECT_EQ(options.Check()->field, "cache_size_gb");
}

}  // namespace
}  // namespace s2gs
