#include "sfm_split/circular_motion/circular_likelihood.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

// One station of twelve photos, a turn in equal steps, and no matches.
struct Setting {
  std::vector<CircularMatches> data;
  CircularPriors priors;
  CircularState state;
};

Setting WithoutMatches() {
  Setting setting;
  CircularMatches matches;
  matches.num_photos = 12;
  setting.data = {matches};
  setting.priors.focal = {{{1000, 0.2}, {}}};
  setting.priors.least_log_focal = {std::log(300.0)};
  setting.priors.most_log_focal = {std::log(4000.0)};
  setting.priors.distortion = {-0.05};
  setting.priors.distortion_sigma = 0.1;
  CircularTurn turn;
  for (int k = 0; k < 12; ++k) turn.angles.push_back(30 * kDegree * k);
  setting.state.lenses = {{std::log(1000.0), -0.05}};
  setting.state.turns = {turn};
  return setting;
}

// Where matches say nothing, priors do.
TEST(RefineCircular, GoesToThePriorsWhereThereAreNoMatches) {
  for (const double factor : {0.7, 1.5}) {
    Setting setting = WithoutMatches();
    setting.state.lenses[0] = {std::log(1000 * factor), 0.1};
    std::vector<double> focal_sigma;
    RefineCircular(setting.data, setting.priors, CircularSteps::kEqualHeld, 50, &setting.state, &focal_sigma);
    EXPECT_NEAR(std::exp(setting.state.lenses[0].log_focal), 1000, 1);
    EXPECT_NEAR(setting.state.lenses[0].distortion, -0.05, 1e-3);
    ASSERT_EQ(focal_sigma.size(), 1U);
    EXPECT_NEAR(focal_sigma[0], 0.2, 1e-3);
  }
}

TEST(RefineCircular, FreeAnglesGoToEqualSteps) {
  Setting setting = WithoutMatches();
  setting.priors.angles = setting.state.turns;
  setting.state.turns[0].angles[5] += 4 * kDegree;
  RefineCircular(setting.data, setting.priors, CircularSteps::kFree, 50, &setting.state, nullptr);
  EXPECT_NEAR(setting.state.turns[0].angles[5], 150 * kDegree, 0.01 * kDegree);
}

}  // namespace
}  // namespace s2gs
