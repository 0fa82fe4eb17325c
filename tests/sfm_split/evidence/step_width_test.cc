#include "sfm_split/evidence/step_width.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/evidence/step_evidence.h"
#include "sfm_split/evidence/turn_likelihood.h"
#include "sfm_split/scene/axis_turn.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

std::vector<AngleAtPlace> Steps(int num, double step_deg, double start_deg) {
  std::vector<AngleAtPlace> angles;
  for (int k = 0; k < num; ++k)
    angles.push_back({10 + k, k, WrapAngle((start_deg + step_deg * k) * kDegree)});
  return angles;
}

TEST(NearestEqualSteps, ATurnClosesThoughAThirdOfItsAnglesIsAnywhere) {
  std::vector<AngleAtPlace> angles = Steps(24, 15, 77);
  for (int k = 6; k < 14; ++k) angles[static_cast<size_t>(k)].angle_rad += (k - 5) * 5 * kDegree;
  const EqualStepsPrior steps = NearestEqualSteps(angles, 24);
  ASSERT_EQ(steps.places.size(), 24U);
  EXPECT_TRUE(steps.closes);
  EXPECT_NEAR(steps.step_rad, 15 * kDegree, 1e-12);
  EXPECT_NEAR(WrapAngle(steps.offset_rad - 77 * kDegree), 0, 1e-9);
  EXPECT_EQ(steps.places[3].image, 13);
}

TEST(NearestEqualSteps, TheOtherWayAroundWithPhotosMissing) {
  std::vector<AngleAtPlace> angles = Steps(20, -18, 3);
  angles.erase(angles.begin() + 5, angles.begin() + 8);
  const EqualStepsPrior steps = NearestEqualSteps(angles, 20);
  ASSERT_EQ(steps.places.size(), 17U);
  EXPECT_TRUE(steps.closes);
  EXPECT_NEAR(steps.step_rad, -18 * kDegree, 1e-12);
}

TEST(NearestEqualSteps, APartOfATurnStaysOne) {
  const EqualStepsPrior steps = NearestEqualSteps(Steps(24, 10, -40), 24);
  ASSERT_EQ(steps.places.size(), 24U);
  EXPECT_FALSE(steps.closes);
  EXPECT_NEAR(steps.step_rad, 10 * kDegree, 1e-9);
}

// Every other photo is late by .6 degrees: most steps of one seem .6 too long, and all of them together are
// not.
TEST(NearestEqualSteps, OpenStepsAreThoseOfAllAngles) {
  std::vector<AngleAtPlace> angles = Steps(24, 10, -40);
  for (size_t k = 1; k < angles.size(); k += 2)
    angles[k].angle_rad = WrapAngle(angles[k].angle_rad + 0.6 * kDegree);
  const EqualStepsPrior steps = NearestEqualSteps(angles, 24);
  ASSERT_EQ(steps.places.size(), 24U);
  EXPECT_FALSE(steps.closes);
  EXPECT_NEAR(steps.step_rad, 10 * kDegree, 0.01 * kDegree);
}

TEST(NearestEqualSteps, FewAnglesAreNone) {
  EXPECT_TRUE(NearestEqualSteps(Steps(5, 10, 0), 36).places.empty());
}

// Half of the photos follow their neighbours by one step: as many as tell what a step is.
TEST(NearestEqualSteps, AreToldByHalfOfThePhotos) {
  std::vector<AngleAtPlace> angles = Steps(12, 10, 5);
  for (const int place : {10, 7, 4, 1}) angles.erase(angles.begin() + place);
  ASSERT_EQ(angles.size(), 8U);  // places 0 2 3 5 6 8 9 11: three single steps
  EXPECT_TRUE(NearestEqualSteps(angles, 36).places.empty());
  angles = Steps(12, 10, 5);
  for (const int place : {8, 5, 2}) angles.erase(angles.begin() + place);
  angles.pop_back();
  ASSERT_EQ(angles.size(), 8U);  // places 0 1 3 4 6 7 9 10: four
  const EqualStepsPrior steps = NearestEqualSteps(angles, 36);
  ASSERT_EQ(steps.places.size(), 8U);
  EXPECT_NEAR(steps.step_rad, 10 * kDegree, 1e-9);
}

class StepWidth : public testing::Test {
 protected:
  static SyntheticTurntableOptions Options() {
    SyntheticTurntableOptions options;
    options.stations = 2;
    options.steps = 24;
    options.min_elevation_deg = 15;  // from where both see much of the same
    options.max_elevation_deg = 30;
    options.num_object_points = 150;
    options.num_platter_points = 0;
    options.num_background_points = 60;
    options.max_view_change_deg = 40;
    options.pixel_noise = 0.5;
    options.outlier_share = 0.3;
    return options;
  }

  explicit StepWidth(const SyntheticTurntableOptions& options = Options())
      : turntable_(MakeSyntheticTurntable(options)), features_(SyntheticScanFeatures(turntable_)) {}

  struct Posed {
    std::vector<const Camera*> cameras;
    std::vector<const View*> views;
  };
  Posed AllPosed() const {
    Posed posed;
    for (const ScanImage& image : features_.images) {
      posed.cameras.push_back(&features_.cameras.at(image.camera_id));
      posed.views.push_back(&*std::find_if(turntable_.scene.views.begin(), turntable_.scene.views.end(),
                                           [&](const View& view) { return view.name == image.name; }));
    }
    return posed;
  }

  StepsFinding Find() const {
    const Posed posed = AllPosed();
    return StepsByMatches(features_, posed.cameras, posed.views, turntable_.scene.axis, 0.01);
  }

  std::vector<int> UntoldStations() const {
    const Posed posed = AllPosed();
    const std::vector<bool> in_steps(features_.images.size(), false);
    return AskSteps(features_, posed.cameras, posed.views, turntable_.scene.axis, {}, in_steps, 1, 0.01)
        .untold_stations;
  }

  // The mean width by all photos [degrees], term by term.
  double WidthByDefinition() const {
    std::vector<double> turns = {0};
    for (double turn = 0.02; turn <= 60; turn *= 1.4) turns.insert(turns.end(), {turn, -turn});
    std::sort(turns.begin(), turns.end());
    const std::map<size_t, std::vector<double>> logs = LogsOfTurns(turns);
    const auto below = [](double turn, double width) {
      return 0.5 * (1 + std::erf(turn / width / std::sqrt(2.0)));
    };
    std::vector<double> widths, posterior;
    for (double width = 0.01; width <= 1; width *= 1.1) {
      double sum = 0;
      for (const auto& [image, log] : logs) {
        const double highest = std::max(0.0, *std::max_element(log.begin(), log.end()));
        double about = 0;
        double anywhere = (360 - 2 * turns.back()) * std::exp(-highest);
        for (size_t t = 0; t < turns.size(); ++t) {
          const double value = std::exp(log[t] - highest);
          const double from = t == 0 ? 0 : below((turns[t - 1] + turns[t]) / 2, width);
          const double to = t + 1 == turns.size() ? 1 : below((turns[t] + turns[t + 1]) / 2, width);
          about += (to - from) * value;
          if (t > 0) anywhere += (turns[t] - turns[t - 1]) * (value + std::exp(log[t - 1] - highest)) / 2;
        }
        sum += (highest + std::log(0.9 * about + 0.1 * anywhere / 360)) / 2;
      }
      widths.push_back(width);
      posterior.push_back(sum);
    }
    const double highest = *std::max_element(posterior.begin(), posterior.end());
    double all = 0;
    for (double& value : posterior) all += value = std::exp(value - highest);
    double mean = 0;
    for (size_t k = 0; k < widths.size(); ++k) mean += posterior[k] / all * widths[k];
    return mean;
  }

  // Of each photo, against where its turn would be by equal steps.
  std::map<size_t, std::vector<double>> LogsOfTurns(const std::vector<double>& turns) const {
    const size_t middle = turns.size() / 2;
    const Posed posed = AllPosed();
    std::map<size_t, std::vector<double>> logs;
    for (const int station : {0, 1}) {
      std::vector<AngleAtPlace> angles;
      for (size_t i = 0; i < posed.views.size(); ++i) {
        if (features_.images[i].station != station) continue;
        const auto place = static_cast<int>(angles.size());
        angles.push_back({static_cast<int>(i), place, posed.views[i]->angle_deg * kDegree});
      }
      const EqualStepsPrior steps = NearestEqualSteps(angles, static_cast<int>(angles.size()));
      std::vector<int> images;
      std::vector<View> placed;
      placed.reserve(angles.size());
      std::vector<const View*> views(posed.views.size(), nullptr);
      for (const EqualStepsPrior::Place& place : steps.places) {
        const auto i = static_cast<size_t>(place.image);
        const double angle = steps.offset_rad + steps.step_rad * place.steps;
        placed.push_back(*posed.views[i]);
        placed.back().angle_deg = angle / kDegree;
        placed.back().world_from_object = TurnAbout(turntable_.scene.axis, angle);
        views[i] = &placed.back();
        images.push_back(place.image);
        logs[i].assign(turns.size(), 0);
      }
      const TurnLikelihood likelihood(posed.cameras, views, turntable_.scene.axis);
      const std::vector<TurnPair> pairs = NearPairs(features_, views, images, images, {});
      const double noise = likelihood.Noise(pairs);
      for (const TurnPair& pair : pairs) {
        const std::vector<double> gains = likelihood.OfTurns(pair, turns, noise);
        for (size_t t = 0; t < turns.size(); ++t) {
          logs[pair.image2][t] += gains[t] - gains[middle];
          logs[pair.image1][turns.size() - 1 - t] += gains[t] - gains[middle];
        }
      }
    }
    return logs;
  }

  // A photo's keypoints as those of a photo at another angle: its view says that it is where it is not.
  void Turn(size_t image, double degrees) {
    View& view = turntable_.scene.views[image];
    view.angle_deg += degrees;
    view.world_from_object = TurnAbout(turntable_.scene.axis, degrees * kDegree) * view.world_from_object;
  }

  SyntheticTurntable turntable_;
  ScanFeatures features_;
};

TEST_F(StepWidth, EqualStepsAreAsNarrowAsTheMatchesCanTell) {
  const StepsFinding finding = Find();
  ASSERT_EQ(finding.steps.size(), 2U);
  EXPECT_TRUE(finding.elsewhere.empty());
  EXPECT_GT(finding.steps[0].sigma_rad, 0);
  EXPECT_LT(finding.steps[0].sigma_rad, 0.3 * kDegree);
}

// By its definition: of each photo's likelihood over turns from its place, .9 of what it is in the mean about
// the place by a width, and .1 of its mean over the circle. Each pair counts for two photos, by half.
TEST_F(StepWidth, IsWhatAllPhotosSay) {
  const double width = WidthByDefinition();
  const StepsFinding finding = Find();
  ASSERT_EQ(finding.steps.size(), 2U);
  EXPECT_NEAR(finding.steps[0].sigma_rad, width * kDegree, 1e-9);
  EXPECT_EQ(finding.steps[1].sigma_rad, finding.steps[0].sigma_rad);
  EXPECT_GT(width, 0.011);
}

// All widths from .01 to 1 degrees are as likely then, each order of magnitude as much as another: a
// density of 1 / (w ln 100). Widths are a tenth apart, which is worth half a per cent.
TEST_F(StepWidth, WhereMatchesTellNothingStepsAreNotTakenForEqual) {
  for (ImagePairMatches& pair : features_.object_pairs) pair.matches.clear();
  features_.raw_pairs.clear();
  const double width_deg = (1 - 0.01) / std::log(100.0);
  EXPECT_NEAR(Find().steps.at(0).sigma_rad, width_deg * kDegree, 0.02 * width_deg * kDegree);
}

// The angles that the views have do not count: three in ten are off by many degrees.
TEST_F(StepWidth, AnglesThatAreWrongDoNotWidenIt) {
  const double right = Find().steps.at(0).sigma_rad;
  for (const size_t image : {3, 4, 5, 6, 9, 10, 17}) Turn(image, 7 + static_cast<double>(image));
  const StepsFinding finding = Find();
  EXPECT_TRUE(finding.elsewhere.empty());
  EXPECT_NEAR(finding.steps.at(0).sigma_rad, right, 1e-9);
}

TEST_F(StepWidth, AStationWhoseMatchesTellNothingHasTheOthersWidth) {
  const double both = Find().steps.at(0).sigma_rad;
  auto& pairs = features_.object_pairs;
  pairs.erase(std::remove_if(pairs.begin(), pairs.end(),
                             [&](const ImagePairMatches& pair) {
                               return features_.images[static_cast<size_t>(pair.image1)].station == 0 &&
                                      features_.images[static_cast<size_t>(pair.image2)].station == 0;
                             }),
              pairs.end());
  features_.raw_pairs.clear();
  const StepsFinding finding = Find();
  ASSERT_EQ(finding.steps.size(), 2U);
  EXPECT_EQ(finding.steps[0].sigma_rad, finding.steps[1].sigma_rad);
  EXPECT_LT(finding.steps[0].sigma_rad, 3 * both);
}

TEST_F(StepWidth, MatchesTellThatTheTableTurnedAndWhichWay) {
  EXPECT_TRUE(UntoldStations().empty());
  // The second station's views say that it stood still.
  for (size_t image = 24; image < 48; ++image) Turn(image, -turntable_.scene.views[image].angle_deg);
  EXPECT_EQ(UntoldStations(), (std::vector<int>{24}));
}

// Where all matches of a station are wrong, it may as well stand still.
TEST_F(StepWidth, WrongMatchesDoNotTellHowTheTableTurned) {
  for (auto* pairs : {&features_.object_pairs, &features_.raw_pairs}) {
    for (ImagePairMatches& pair : *pairs) {
      if (pair.image1 < 24 || pair.image2 < 24) continue;
      for (size_t m = 0; m + 1 < pair.matches.size(); ++m)
        std::swap(pair.matches[m].point2D_idx2, pair.matches[m + 1].point2D_idx2);
    }
  }
  EXPECT_EQ(UntoldStations(), (std::vector<int>{24}));
}

// Photos whose own matches tell nothing have their places from the series that they belong to.
TEST_F(StepWidth, APhotoInASeriesIsTold) {
  for (auto* pairs : {&features_.object_pairs, &features_.raw_pairs}) {
    for (ImagePairMatches& pair : *pairs) {
      if (pair.image1 == 5 || pair.image2 == 5) pair.matches.clear();
    }
  }
  const Posed posed = AllPosed();
  std::vector<bool> in_steps(features_.images.size(), false);
  const auto untold = [&] {
    return AskSteps(features_, posed.cameras, posed.views, turntable_.scene.axis, {}, in_steps, 1, 0.01)
        .untold;
  };
  EXPECT_EQ(untold(), (std::vector<int>{5}));
  in_steps[5] = true;
  EXPECT_TRUE(untold().empty());
}

// One photo that its matches put elsewhere, among steps that the others bear out, has wrong matches; more
// than a tenth have steps that are none.
TEST_F(StepWidth, StepsOutweighAFewPhotosMatches) {
  const auto misturned = [&](bool in_steps) {
    const Posed posed = AllPosed();
    return AskSteps(features_, posed.cameras, posed.views, turntable_.scene.axis, {},
                    std::vector<bool>(features_.images.size(), in_steps), 1, 0.01)
        .misturned.size();
  };
  Turn(5, 9);
  EXPECT_GE(misturned(false), 1U);
  EXPECT_EQ(misturned(true), 0U);
  for (const size_t image : {9, 13, 17, 20, 28, 33, 40}) Turn(image, 9);
  EXPECT_GE(misturned(true), 8U);
}

class NearlyEqualSteps : public StepWidth {
 protected:
  static SyntheticTurntableOptions Nearly() {
    SyntheticTurntableOptions options = Options();
    options.step_jitter = 0.04;  // +- 2 % of 15 degrees, which add up
    return options;
  }
  NearlyEqualSteps() : StepWidth(Nearly()) {}
};

// Some photos stand so far from their places that only a wide scatter explains them better than chance.
TEST_F(NearlyEqualSteps, AreAsWideAsAllPhotosSay) {
  const double width = WidthByDefinition();
  EXPECT_GT(width, 0.2);
  EXPECT_LT(width, 0.9);
  EXPECT_NEAR(Find().steps.at(0).sigma_rad, width * kDegree, 1e-9);
}

class UnequalSteps : public StepWidth {
 protected:
  static SyntheticTurntableOptions Uneven() {
    SyntheticTurntableOptions options = Options();
    options.step_jitter = 0.4;  // +- 20 % of 15 degrees, which add up
    return options;
  }
  UnequalSteps() : StepWidth(Uneven()) {}
};

TEST_F(UnequalSteps, AreWide) {
  const StepsFinding finding = Find();
  ASSERT_FALSE(finding.steps.empty());
  // Steps differ by 1.7 degrees (standard deviation of a uniform one in +- 3), and that adds up.
  EXPECT_GT(finding.steps[0].sigma_rad, 0.5 * kDegree);
  EXPECT_FALSE(finding.elsewhere.empty());
}

class NoSteps : public StepWidth {
 protected:
  static SyntheticTurntableOptions Wild() {
    SyntheticTurntableOptions options = Options();
    options.step_jitter = 0.8;  // +- 40 % of 15 degrees
    return options;
  }
  NoSteps() : StepWidth(Wild()) {}
};

// Far more photos than one in ten stand elsewhere: as many as a third of each station's.
TEST_F(NoSteps, AreNotEqual) {
  const StepsFinding finding = Find();
  EXPECT_TRUE(finding.steps.empty());
  EXPECT_GE(finding.elsewhere.size(), 16U);
}

}  // namespace
}  // namespace s2gs
