#include "plugin/mapping/mapping_failure.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

namespace s2gs {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

// Three photos of `count` features each, of which those of all pairs match, `step` pixels further in each
// photo.
ScanFeatures Photos(int count, int matches, float step) {
  ScanFeatures features;
  for (int photo = 0; photo < 3; ++photo) {
    ScanImage image;
    for (int k = 0; k < count; ++k) {
      image.keypoints.emplace_back(10.0F * static_cast<float>(k) + step * static_cast<float>(photo), 5.0F);
    }
    features.images.push_back(image);
  }
  for (const auto& [first, second] : {std::pair(0, 1), std::pair(1, 2), std::pair(0, 2)}) {
    ImagePairMatches pair;
    pair.image1 = first;
    pair.image2 = second;
    for (int k = 0; k < matches; ++k)
      pair.matches.push_back({static_cast<uint32_t>(k), static_cast<uint32_t>(k)});
    features.raw_pairs.push_back(pair);
  }
  return features;
}

std::string Explanation(const ScanFeatures& features) {
  return ExplainNoModel("split/object.db", features).what();
}

TEST(MappingFailure, NamesWhatThePhotosLack) {
  EXPECT_THAT(Explanation(Photos(99, 50, 30)),
              AllOf(HasSubstr("split/object.db"), HasSubstr("too little texture"), HasSubstr("99 features"),
                    HasSubstr("speckled")));
  ScanFeatures few = Photos(500, 19, 30);
  for (int photo = 0; photo < 3; ++photo) few.images[static_cast<size_t>(photo)].station = photo;
  EXPECT_THAT(Explanation(few),
              AllOf(HasSubstr("no two of them show 20 points in common"), HasSubstr("smaller steps")));
  EXPECT_THAT(
      Explanation(Photos(500, 200, 0)),
      AllOf(HasSubstr("100 % of what they have in common stands still"), HasSubstr("different angles")));
  EXPECT_THAT(Explanation(Photos(500, 200, 30)),
              AllOf(HasSubstr("3 pairs have matches"), HasSubstr("--log_level debug")));
}

TEST(MappingFailure, PhotosOfOneStationWithoutMatchesShowNothingThatTurns) {
  // All are of station 0, and the split left no matches.
  EXPECT_THAT(
      Explanation(Photos(500, 0, 0)),
      AllOf(HasSubstr("3 of 3 show the same from one camera position"), HasSubstr("different angles")));
  ScanFeatures apart = Photos(500, 0, 0);
  for (int photo = 0; photo < 3; ++photo) apart.images[static_cast<size_t>(photo)].station = photo;
  EXPECT_THAT(Explanation(apart), HasSubstr("no two of them show 20 points in common"));
}

TEST(MappingFailure, ASmallShareThatMovesIsNoTurn) {
  // A tenth of the matches moves: at nine tenths that stand still, the photos are said to.
  ScanFeatures features = Photos(500, 200, 0);
  for (int photo = 0; photo < 3; ++photo) {
    for (int k = 0; k < 20; ++k) features.images[photo].keypoints[k].x() += 30.0F * static_cast<float>(photo);
  }
  EXPECT_THAT(Explanation(features), HasSubstr("90 % of what"));
  for (int photo = 0; photo < 3; ++photo) {
    for (int k = 20; k < 40; ++k)
      features.images[photo].keypoints[k].x() += 30.0F * static_cast<float>(photo);
  }
  EXPECT_THAT(Explanation(features), Not(HasSubstr("stands still")));
}

TEST(MappingFailure, CountsTheObjectsMatchesWhereThereAreNoOthers) {
  ScanFeatures features = Photos(500, 200, 0);
  std::swap(features.object_pairs, features.raw_pairs);
  EXPECT_THAT(Explanation(features), HasSubstr("stands still"));
  EXPECT_THAT(Explanation({}), HasSubstr("no two of them"));
}

// Two photos of four from one position are no more than half of them.
TEST(MappingFailure, HalfOfThePhotosFromOnePositionIsNoReason) {
  ScanFeatures features = Photos(500, 0, 0);
  features.images.push_back(features.images[0]);
  for (int photo = 0; photo < 4; ++photo)
    features.images[static_cast<size_t>(photo)].station = std::max(0, photo - 1);
  EXPECT_THAT(Explanation(features), HasSubstr("no two of them show 20 points in common"));
  features.images.pop_back();
  EXPECT_THAT(Explanation(features), HasSubstr("2 of 3 show the same from one camera position"));
}

}  // namespace
}  // namespace s2gs
