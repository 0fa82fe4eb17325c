#include "sfm_split/evidence/verdict.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <functional>
#include <limits>
#include <string>
#include <utility>

namespace s2gs {
namespace {

ScanEvidence GoodEvidence() {
  ScanEvidence evidence;
  evidence.photos = evidence.placed = 24;
  evidence.bound_px = 4;
  evidence.verified = {5000, 4800, 50};
  evidence.held_back = {100, 96, 1};
  evidence.adjusted = {900, 870, 9};
  evidence.neighbours = {2000, 1950, 30};
  evidence.neighbour_pairs = 44;
  evidence.seam = {80, 78, 2};
  evidence.seam_pairs = 3;
  evidence.closing = evidence.seam;
  evidence.stations = evidence.closed_stations = evidence.round_stations = 1;
  evidence.median_step_deg = 15;
  evidence.least_step_deg = 4;
  evidence.adjusted_noise_px = 0.4;
  evidence.held_back_noise_px = 0.42;
  evidence.focal_widths = {1.2};
  evidence.angle_sigma_median_deg = 0.02;
  evidence.angle_sigma_max_deg = 0.05;
  return evidence;
}

TEST(Verdict, WhatIsBorneOutIsGoodAndSaysWhy) {
  const ScanVerdict verdict = JudgeScan(GoodEvidence());
  EXPECT_EQ(verdict.verdict, Verdict::kGood);
  EXPECT_FALSE(verdict.reasons.empty());
  EXPECT_TRUE(verdict.advice.empty());
}

TEST(Verdict, AFewDetailsThatWereHeldBackSayLittle) {
  ScanEvidence evidence = GoodEvidence();
  evidence.held_back_noise_px = 1.0;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
  evidence.held_back = {4, 4, 0};
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
}

// The poses may be good, and what is built on them too deep or too flat.
TEST(Verdict, AGoodScanSaysHowWellItsFocalLengthIsKnown) {
  ScanEvidence evidence = GoodEvidence();
  evidence.focal_sigma_rel = 0.003;
  for (const std::string& reason : JudgeScan(evidence).reasons)
    EXPECT_EQ(reason.find("focal length"), std::string::npos) << reason;
  evidence.focal_sigma_rel = 0.043;
  const ScanVerdict verdict = JudgeScan(evidence);
  EXPECT_EQ(verdict.verdict, Verdict::kGood);
  EXPECT_THAT(verdict.reasons.back(), testing::HasSubstr("the focal length is known to +- 4.3 %"));
  EXPECT_TRUE(verdict.advice.empty());
  evidence.focal_sigma_rel = std::numeric_limits<double>::infinity();
  EXPECT_THAT(JudgeScan(evidence).reasons.back(), testing::HasSubstr("cannot be told from the photos"));
}

TEST(Verdict, AFocalLengthThatEXIFStatesWronglyIsSaidAndNotJudged) {
  ScanEvidence evidence = GoodEvidence();
  evidence.wrong_exif_focal = 0.4;
  const ScanVerdict verdict = JudgeScan(evidence);
  EXPECT_EQ(verdict.verdict, Verdict::kGood);
  EXPECT_THAT(verdict.reasons.back(), testing::HasSubstr("EXIF states 0.4 times the focal length"));
  EXPECT_TRUE(verdict.advice.empty());
}

TEST(Verdict, PosesHoldWhereOnlyAFewPhotosHaveNone) {
  ScanEvidence evidence = GoodEvidence();
  EXPECT_TRUE(JudgeScan(evidence).poses_hold);
  evidence.placed = 22;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
  EXPECT_TRUE(JudgeScan(evidence).poses_hold);
  evidence.placed = 21;
  EXPECT_FALSE(JudgeScan(evidence).poses_hold);
  evidence.placed = 23;
  evidence.angle_sigma_max_deg = 0.8;
  EXPECT_FALSE(JudgeScan(evidence).poses_hold);
}

TEST(Verdict, EachFaultIsNamedWithWhatToDoAboutIt) {
  struct Case {
    const char* said;
    Verdict verdict;
    void (*change)(ScanEvidence*);
  };
  const Case cases[] = {
      {"20 of 24", Verdict::kDoubtful, [](ScanEvidence* e) { e->placed = 20; }},
      {"23 of 24 photos have a place, without: s0_07.jpg", Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->placed = 23;
         e->missing = {"s0_07.jpg"};
       }},
      {"a, b, c, d, e and 1 more", Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->placed = 18;
         e->missing = {"a", "b", "c", "d", "e", "f"};
       }},
      {"11 of 24", Verdict::kFailed, [](ScanEvidence* e) { e->placed = 11; }},
      {"does not close", Verdict::kFailed,
       [](ScanEvidence* e) {
         e->seam = {60, 5, 2};
       }},
      {"next to each other prove", Verdict::kFailed, [](ScanEvidence* e) { e->neighbours.agreeing = 700; }},
      {"contradict", Verdict::kDoubtful, [](ScanEvidence* e) { e->contradicted_neighbours = 8; }},
      {"3 photos are up to 7.5 degrees of the table from where their matches put them, like c",
       Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->misturned = {"c", "d", "e"};
         e->worst_misturn_deg = 7.5;
       }},
      {"the matches of 3 photos, like x, do not tell", Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->untold = {"x", "y", "z"};
       }},
      {"held back", Verdict::kFailed, [](ScanEvidence* e) { e->held_back.agreeing = 40; }},
      {"miss their lines", Verdict::kDoubtful, [](ScanEvidence* e) { e->held_back_noise_px = 1.1; }},
      {"1 degrees of the table apart", Verdict::kFailed, [](ScanEvidence* e) { e->median_step_deg = -1; }},
      {"miss their lines by 2.1 px", Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->match_noise_px = 2.1;
         e->adjusted_noise_px = e->held_back_noise_px = 2.2;
       }},
      {"do not tell whether the table turned as the poses say, like that of q", Verdict::kDoubtful,
       [](ScanEvidence* e) { e->untold_stations = {"q"}; }},
      {"a table angle is known to +- 0.8", Verdict::kDoubtful,
       [](ScanEvidence* e) { e->angle_sigma_max_deg = 0.8; }},
      {"cannot be told", Verdict::kDoubtful,
       [](ScanEvidence* e) { e->angle_sigma_max_deg = std::numeric_limits<double>::infinity(); }},
      {"nearer to the camera", Verdict::kFailed,
       [](ScanEvidence* e) {
         e->camera_radius_rel = 0.1;
         e->points_one_side = 0.99;
         e->camera_height_rel = 0.2;
       }},
      {"came back the same way", Verdict::kDoubtful, [](ScanEvidence* e) { e->turns_of_nothing = 1; }},
      {"miss their lines by 2.3 px", Verdict::kDoubtful,
       [](ScanEvidence* e) { e->adjusted_noise_px = e->held_back_noise_px = 2.3; }},
      {"94 degrees apart", Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->neighbour_apart_deg = 11;
         e->far_pairs = 3;
         e->widest_far_pair_deg = 94;
       }},
      {"a guess", Verdict::kDoubtful, [](ScanEvidence* e) { e->is_focal_guessed = true; }},
      {"was not computed", Verdict::kDoubtful, [](ScanEvidence* e) { e->are_sigmas_missing = true; }},
      {"focal length", Verdict::kFailed, [](ScanEvidence* e) { e->focal_widths = {0.036}; }},
      {"matches of 5 photos bear out", Verdict::kDoubtful,
       [](ScanEvidence* e) {
         e->unsupported = {"a", "b", "c", "d", "e"};
       }},
      {"nothing was found to turn", Verdict::kFailed,
       [](ScanEvidence* e) {
         e->is_one_body = true;
         e->unmoved_photos = 24;
       }},
  };
  for (const Case& fault : cases) {
    ScanEvidence evidence = GoodEvidence();
    fault.change(&evidence);
    const ScanVerdict verdict = JudgeScan(evidence);
    EXPECT_EQ(VerdictName(verdict.verdict), std::string(VerdictName(fault.verdict))) << fault.said;
    ASSERT_FALSE(verdict.reasons.empty()) << fault.said;
    EXPECT_NE(verdict.reasons[0].find(fault.said), std::string::npos) << verdict.reasons[0];
    EXPECT_FALSE(verdict.advice.empty()) << fault.said;
  }
}

TEST(Verdict, WhatWasNotMeasuredIsNotHeldAgainstAScan) {
  ScanEvidence evidence;
  evidence.photos = evidence.placed = 24;
  evidence.verified = {5000, 4800, 50};
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
}

// Verified matches of what shines have errors that are not the poses', and so may unverified ones.
TEST(Verdict, TheSmallerNoiseIsThatOfRightMatches) {
  ScanEvidence evidence = GoodEvidence();
  evidence.adjusted_noise_px = evidence.held_back_noise_px = 4.5;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
  evidence.match_noise_px = 0.3;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
  std::swap(evidence.match_noise_px, evidence.adjusted_noise_px);
  evidence.held_back_noise_px = 0.3;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
}

// Photos far apart of what shines and looks alike all around prove what is wrong; a closed turn is proof.
TEST(Verdict, AClosedTurnNeedsNoFarPairs) {
  ScanEvidence evidence = GoodEvidence();
  evidence.verified = {5000, 2300, 50};
  evidence.held_back = {100, 44, 1};
  evidence.adjusted = {900, 420, 9};
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
  const std::array<std::function<void(ScanEvidence*)>, 7> changes = {
      [](ScanEvidence* e) { e->closing = {}; },  // as an arc's, whose last photos may match its first
      [](ScanEvidence* e) { e->closing.agreeing = 66; },
      [](ScanEvidence* e) { e->stations = 2; },  // one of which is an arc
      [](ScanEvidence* e) { e->neighbours.agreeing = 1700; },
      [](ScanEvidence* e) { e->contradicted_seams = 1; },
      [](ScanEvidence* e) { e->turns_of_nothing = 1; },
      [](ScanEvidence* e) { e->held_back.agreeing = 20; },  // fewer than half of those that were adjusted
  };
  for (size_t k = 0; k < changes.size(); ++k) {
    ScanEvidence changed = evidence;
    changes[k](&changed);
    EXPECT_EQ(JudgeScan(changed).verdict, Verdict::kFailed) << k;
  }
}

// What closes tells the lens, and the lens how far neighbours are apart at other stations.
TEST(Verdict, AClosedTurnSpeaksForAnotherThatGoesRoundBeforeTheSameLens) {
  ScanEvidence evidence = GoodEvidence();
  evidence.held_back = {100, 44, 1};
  evidence.adjusted = {900, 420, 9};
  evidence.stations = evidence.round_stations = 2;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
  ScanEvidence none_closes = evidence;
  none_closes.closed_stations = 0;
  EXPECT_EQ(JudgeScan(none_closes).verdict, Verdict::kFailed);
  ScanEvidence two_lenses = evidence;
  two_lenses.focal_widths = {1.2, 1.2};
  EXPECT_EQ(JudgeScan(two_lenses).verdict, Verdict::kFailed);
}

TEST(Verdict, StationsThatNothingTiesWantATurnFromBetween) {
  ScanEvidence evidence = GoodEvidence();
  evidence.angle_sigma_max_deg = std::numeric_limits<double>::infinity();
  const auto wants_between = [&] {
    return JudgeScan(evidence).advice[0].find("between the camera places") != std::string::npos;
  };
  evidence.stations = 1;
  EXPECT_FALSE(wants_between());
  evidence.stations = 2;
  EXPECT_TRUE(wants_between());
}

TEST(Verdict, AnglesThatALevelCameraDoesNotTellWantAHigherOne) {
  ScanEvidence evidence = GoodEvidence();
  evidence.angle_sigma_max_deg = 1.3;
  evidence.camera_height_rel = 1.1;
  EXPECT_EQ(JudgeScan(evidence).advice[0].find("looks down"), std::string::npos);
  evidence.camera_height_rel = 0.1;
  EXPECT_NE(JudgeScan(evidence).advice[0].find("looks down"), std::string::npos);
  evidence.stations = 2;
  EXPECT_EQ(JudgeScan(evidence).advice[0].find("looks down"), std::string::npos);
}

// A degree within three standard deviations.
TEST(Verdict, AnglesAreGoodToADegreeButForOneScanInFourHundred) {
  ScanEvidence evidence = GoodEvidence();
  evidence.angle_sigma_max_deg = 0.33;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
  evidence.angle_sigma_max_deg = 0.34;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
}

// A guessed length is no matter where the angles are known for all that.
TEST(Verdict, AGuessedFocalLengthMattersWhereAnglesAreLoose) {
  const auto names_guess = [](double angle_sigma_max_deg) {
    ScanEvidence evidence = GoodEvidence();
    evidence.focal_prior_share = 0.99;
    evidence.focal_sigma_rel = 0.1;
    evidence.angle_sigma_max_deg = angle_sigma_max_deg;
    for (const std::string& reason : JudgeScan(evidence).reasons) {
      if (reason.find("most of what is known of the focal length is a guess") != std::string::npos)
        return true;
    }
    return false;
  };
  EXPECT_FALSE(names_guess(0.3));
  EXPECT_TRUE(names_guess(0.4));
}

// An axis is what all photos of a station are wrong by, and so their median: .3 degrees are asked of that, of
// 19 scans in 20.
TEST(Verdict, TheAxisAndTheMedianAngleAreAskedForMoreThanOneAngleIs) {
  ScanEvidence evidence = GoodEvidence();
  evidence.angle_sigma_max_deg = 0.3;
  evidence.angle_sigma_median_deg = 0.149;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
  evidence.angle_sigma_median_deg = 0.151;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
  EXPECT_THAT(JudgeScan(evidence).reasons[0], testing::HasSubstr("angles are known to +- 0.15 degrees only"));
  evidence.angle_sigma_median_deg = 0.1;
  evidence.axis_sigma_deg = 0.149;
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kGood);
  evidence.axis_sigma_deg = 0.34;
  const ScanVerdict verdict = JudgeScan(evidence);
  EXPECT_EQ(verdict.verdict, Verdict::kDoubtful);
  EXPECT_THAT(verdict.reasons[0], testing::HasSubstr("axis is known to +- 0.34 degrees only"));
  EXPECT_EQ(JudgeScan(evidence).advice[0].find("cut from larger ones"), std::string::npos);
  evidence.are_photos_cut = true;
  EXPECT_NE(JudgeScan(evidence).advice[0].find("cut from larger ones"), std::string::npos);
}

TEST(Verdict, ChanceIsTakenOffAShare) {
  EXPECT_DOUBLE_EQ(*(AgreeingMatches{100, 100, 40}).Share(), 1);
  EXPECT_DOUBLE_EQ(*(AgreeingMatches{100, 40, 40}).Share(), 0);
  EXPECT_DOUBLE_EQ(*(AgreeingMatches{100, 70, 40}).Share(), 0.5);
  EXPECT_FALSE((AgreeingMatches{}).Share().has_value());
  EXPECT_FALSE((AgreeingMatches{10, 10, 10}).Share().has_value());
}

}  // namespace
}  // namespace s2gs
