#include "sfm_split/placement/partial_models.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "sfm_split/turntable/align_scene.h"
#include "tests/support/synthetic_models.h"

namespace s2gs {
namespace {

SyntheticTurntable Turntable() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 10;
  options.step_deg = 20;
  options.num_object_points = 100;
  options.num_background_points = 0;
  return MakeSyntheticTurntable(options);
}

TEST(JoinPartialModels, MovesTheSmallerOneOverSharedImages) {
  const SyntheticTurntable turntable = Turntable();
  const ColmapModel exact = SyntheticObjectModel(turntable);
  ColmapModel first = exact;
  ColmapModel second = SyntheticObjectModel(turntable, {2, Eigen::Quaterniond(0, 0, 1, 0), {4, 5, 6}});
  std::vector<std::string> late;
  std::vector<std::string> early;
  for (const auto& [id, image] : exact.images) {
    if (id > 12) late.push_back(image.name);
    if (id < 8) early.push_back(image.name);
  }
  RemoveImages(late, &first);
  RemoveImages(early, &second);
  EXPECT_EQ(JoinPartialModels({second}, &first), 8);
  ASSERT_EQ(first.images.size(), exact.images.size());
  for (const auto& [id, image] : first.images) {
    EXPECT_TRUE(image.cam_from_world.Matrix().isApprox(exact.images.at(id).cam_from_world.Matrix(), 1e-6));
  }
}

TEST(JoinPartialModels, TwoSharedImagesFixNoSimilarity) {
  const SyntheticTurntable turntable = Turntable();
  ColmapModel first = SyntheticObjectModel(turntable);
  ColmapModel second = first;
  std::vector<std::string> late;
  std::vector<std::string> early;
  for (const auto& [id, image] : second.images) (id > 12 ? late : early).push_back(image.name);
  RemoveImages(late, &first);
  early.resize(early.size() - 2);
  RemoveImages(early, &second);
  EXPECT_EQ(JoinPartialModels({second}, &first), 0);
  EXPECT_EQ(first.images.size(), 12U);
}

}  // namespace
}  // namespace s2gs
