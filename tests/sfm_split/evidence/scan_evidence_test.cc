#include "sfm_split/evidence/scan_evidence.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/evidence/held_back.h"
#include "sfm_split/evidence/verdict.h"
#include "sfm_split/scene/axis_turn.h"
#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

// A scan of one full turn whose raw matches are its verified ones.
struct Scan {
  SyntheticTurntable turntable;
  ScanFeatures features;
};

Scan MakeScan(double step_deg = 20) {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 18;
  options.step_deg = step_deg;
  options.num_object_points = 200;
  options.num_platter_points = 80;
  options.num_background_points = 100;
  options.max_view_change_deg = 50;
  options.pixel_noise = 0.3;
  Scan scan;
  scan.turntable = MakeSyntheticTurntable(options);
  scan.features = SyntheticScanFeatures(scan.turntable);
  scan.features.raw_pairs = scan.features.object_pairs;
  return scan;
}

ScanEvidence Gather(const Scan& scan, const TurntableScene& scene) {
  AlignedScene aligned;
  aligned.scene = scene;
  aligned.object = SyntheticObjectModel(scan.turntable);
  return GatherEvidence(scan.features, aligned, JointReport(), {}, HoldBack(scan.features), MatchFindings(),
                        4);
}

TEST(ScanEvidence, TruePosesAreGood) {
  const Scan scan = MakeScan();
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_EQ(evidence.placed, 36);
  EXPECT_GT(*evidence.verified.Share(), 0.95);
  EXPECT_GT(*evidence.seam.Share(), 0.95);
  EXPECT_GT(evidence.seam_pairs, 2);
  EXPECT_EQ(evidence.closing.all, evidence.seam.all);
  EXPECT_EQ(evidence.closed_stations, 2);
  EXPECT_EQ(evidence.round_stations, 2);
  EXPECT_GT(*evidence.across_stations.Share(), 0.95);
  // As many pairs are two steps of 20 degrees apart as one; the median is the upper of both.
  EXPECT_NEAR(*evidence.median_step_deg, 40, 1e-9);
  EXPECT_LT(*evidence.least_step_deg, 40);
  EXPECT_GT(*evidence.camera_radius_rel, 2);
  EXPECT_EQ(evidence.turns_of_nothing, 0);
  EXPECT_EQ(evidence.far_pairs, 0);
  EXPECT_EQ(evidence.contradicted_neighbours, 0);
  EXPECT_TRUE(evidence.misturned.empty());
  EXPECT_TRUE(evidence.untold.empty());
  EXPECT_NEAR(*evidence.held_back_noise_px, 0.3, 0.05);
  EXPECT_NEAR(*evidence.adjusted_noise_px, 0.3, 0.05);
  const ScanVerdict verdict = JudgeScan(evidence);
  EXPECT_EQ(verdict.verdict, Verdict::kGood) << verdict.reasons[0];
}

// EXIF is believed to 15 %, and where there is none nothing is contradicted.
TEST(ScanEvidence, WhatEXIFStatesWronglyIsRecorded) {
  Scan scan = MakeScan();
  const auto wrong_by = [&](double stated, bool is_from_exif) {
    for (auto& [id, camera] : scan.features.cameras) {
      const Camera& true_camera = scan.turntable.scene.cameras[0];
      for (size_t k = 0; k < InfoOf(camera.model).num_focal_params; ++k)
        camera.params[k] = stated * true_camera.params[k];
      scan.features.has_prior_focal[id] = is_from_exif;
    }
    return Gather(scan, scan.turntable.scene).wrong_exif_focal;
  };
  EXPECT_FALSE(wrong_by(1, true).has_value());
  EXPECT_FALSE(wrong_by(1.1, true).has_value());
  EXPECT_FALSE(wrong_by(0.4, false).has_value());
  ASSERT_TRUE(wrong_by(0.4, true).has_value());
  EXPECT_NEAR(*wrong_by(0.4, true), 0.4, 1e-12);
}

// Most matches are wrong, and none was verified: what agrees within the noise is more than chance
// puts there, within thirteen times the noise it is not.
TEST(ScanEvidence, APhotoIsBorneOutWithinTheNoiseOfItsMatches) {
  constexpr size_t kRightOf = 20;
  Scan scan = MakeScan();
  RandomNumbers random(5);
  for (ImagePairMatches& pair : scan.features.raw_pairs) {
    const FeatureMatches right = pair.matches;
    const size_t num2 = scan.features.images[static_cast<size_t>(pair.image2)].keypoints.size();
    pair.matches.resize(right.size() / kRightOf);
    while (pair.matches.size() < right.size()) {
      const uint32_t first = right[pair.matches.size()].point2D_idx1;
      pair.matches.push_back({first, static_cast<uint32_t>(random.Uniform(0, static_cast<double>(num2)))});
    }
  }
  scan.features.object_pairs.clear();
  JointReport joint;
  joint.model = JointModel::kSharedStations;
  const auto num_unsupported = [&](double noise_px, const TurntableScene& scene) {
    AlignedScene aligned;
    aligned.scene = scene;
    aligned.object = SyntheticObjectModel(scan.turntable);
    MatchFindings findings;
    findings.noise_px = noise_px;
    return GatherEvidence(scan.features, aligned, joint, {}, HoldBack(scan.features), findings, 4)
        .unsupported.size();
  };
  // Of 36 photos, measured: 0, 22 and 36.
  EXPECT_EQ(num_unsupported(0.3, scan.turntable.scene), 0U);
  EXPECT_GT(num_unsupported(0, scan.turntable.scene), 9U);
  TurntableScene wrong = scan.turntable.scene;
  for (View& view : wrong.views) {
    view.angle_deg = random.Uniform(-180, 180);
    view.world_from_object = TurnAbout(wrong.axis, view.angle_deg * kDegree);
  }
  EXPECT_GT(num_unsupported(0.3, wrong), 30U);
}

// The second camera place is turned about the axis, and its table angles the other way: nothing that turns
// tells. The background does, unless nothing of it ties the two.
TEST(ScanEvidence, WhatStandsStillTellsThatCamerasStandElsewhere) {
  const Scan scan = MakeScan();
  ASSERT_GT(scan.features.static_pairs.size(), 0U);
  const auto judge = [&](double turn_deg, bool is_tied) {
    AlignedScene aligned;
    aligned.scene = scan.turntable.scene;
    aligned.object = SyntheticObjectModel(scan.turntable);
    if (is_tied) aligned.background = SyntheticStaticModel(scan.turntable);
    const Rigid3 turn = TurnAbout(aligned.scene.axis, turn_deg * kDegree);
    for (View& view : aligned.scene.views) {
      if (view.station != 1) continue;
      view.cam_from_world = view.cam_from_world * turn.Inverse();
      view.world_from_object = turn * view.world_from_object;
      view.angle_deg += turn_deg;
    }
    return GatherEvidence(scan.features, aligned, JointReport(), {}, HoldBack(scan.features), MatchFindings(),
                          4);
  };
  const ScanEvidence right = judge(0, true);
  EXPECT_GT(*right.background_across.Share(), 0.95);
  EXPECT_NEAR(*right.background_noise_px, 0.3, 0.1);
  EXPECT_EQ(JudgeScan(right).verdict, Verdict::kGood);
  const ScanEvidence wrong = judge(2, true);
  EXPECT_GT(*wrong.across_stations.Share(), 0.95);
  EXPECT_EQ(JudgeScan(wrong).verdict, Verdict::kDoubtful);
  EXPECT_NE(JudgeScan(wrong).reasons[0].find("what stands still"), std::string::npos);
  const ScanEvidence untied = judge(2, false);
  EXPECT_EQ(untied.background_across.all, 0);
  EXPECT_EQ(JudgeScan(untied).verdict, Verdict::kGood);
}

// Moves keypoints of matched sets by up to so much in either direction, each set its own way from photo to
// photo.
void Slide(double px, const std::function<bool(size_t image, size_t keypoint)>& is_moved, Scan* scan) {
  RandomNumbers random(3);
  for (size_t i = 0; i < scan->features.images.size(); ++i) {
    auto& keypoints = scan->features.images[i].keypoints;
    for (size_t k = 0; k < keypoints.size(); ++k) {
      if (!is_moved(i, k)) continue;
      keypoints[k].x() += static_cast<float>(random.Uniform(-px, px));
      keypoints[k].y() += static_cast<float>(random.Uniform(-px, px));
    }
  }
}

TEST(ScanEvidence, WhatAnAdjustmentFollowedIsFartherOffWhereItWasHeldBack) {
  Scan scan = MakeScan();
  const HeldBackKeypoints held = HoldBack(scan.features);
  Slide(
      4, [&](size_t image, size_t keypoint) { return held[image][keypoint]; }, &scan);
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_NEAR(*evidence.adjusted_noise_px, 0.3, 0.05);
  EXPECT_GT(*evidence.held_back_noise_px, 1);
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
}

// A third of what is matched slides over the surface, by more than the noise and less than wrong matches err:
// a fit of noise beside wrong ones takes them for either.
TEST(ScanEvidence, FeaturesThatSlideMakeNoNoiseOfWhatWasHeldBack) {
  Scan scan = MakeScan();
  const auto slides = [&](size_t image, size_t keypoint) {
    return scan.turntable.images[image].keypoints[keypoint].point % 3 == 0;
  };
  Slide(6, slides, &scan);
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_NEAR(*evidence.adjusted_noise_px, 0.3, 0.1);
  // Measured 1.19, of 29 sets; a fit of its own 5.6.
  EXPECT_LT(*evidence.held_back_noise_px, 1.6 * *evidence.adjusted_noise_px);
}

// A highlight that stays where it is while the object turns is one detail, though each pair of photos matches
// it: it is wrong once, not 300 times.
TEST(ScanEvidence, ADetailThatAllPhotosShowCountsOnce) {
  Scan scan = MakeScan();
  const ScanEvidence before = Gather(scan, scan.turntable.scene);
  std::vector<ScanImage>& images = scan.features.images;
  for (int highlight = 0; highlight < 20; ++highlight) {
    std::vector<uint32_t> place;
    for (ScanImage& image : images) {
      place.push_back(static_cast<uint32_t>(image.keypoints.size()));
      image.keypoints.emplace_back(310.0F + 3 * static_cast<float>(highlight), 240.0F);
      image.labels.push_back(KeypointLabel::kRotating);
    }
    for (ImagePairMatches& pair : scan.features.object_pairs) {
      pair.matches.push_back(
          {place[static_cast<size_t>(pair.image1)], place[static_cast<size_t>(pair.image2)]});
    }
  }
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  const auto num = [](const ScanEvidence& e) { return e.held_back.all + e.adjusted.all; };
  EXPECT_NEAR(static_cast<double>(num(evidence)), static_cast<double>(num(before) + 2 * 20), 2 * 20);
  EXPECT_LT(*evidence.verified.Share(), 0.93);
  EXPECT_GT(*evidence.adjusted.Share(), 0.9);
  EXPECT_NEAR(*evidence.held_back_noise_px, 0.3, 0.1);
}

// The last photos of a short arc see what the first do, and stand far from them: nothing came back.
TEST(ScanEvidence, AnArcIsNoTurnThatCameBack) {
  const Scan scan = MakeScan(2);
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_GT(evidence.seam_pairs, 2);
  EXPECT_EQ(evidence.turns_of_nothing, 0);
  EXPECT_EQ(evidence.far_pairs, 0);
  EXPECT_EQ(evidence.closing.all, 0);
  EXPECT_EQ(evidence.closed_stations, 0);
  EXPECT_EQ(evidence.round_stations, 0);
  const ScanVerdict verdict = JudgeScan(evidence);
  EXPECT_EQ(verdict.verdict, Verdict::kGood) << verdict.reasons[0];
  for (const std::string& reason : verdict.reasons) {
    EXPECT_EQ(reason.find("end of the turn"), std::string::npos) << reason;
  }
}

// The last photo shows what looks like a share of what the second does, though 132 degrees lie between them:
// its matches with the first are those of the second with the first. \param every  one of so many details is
// found again.
Scan WithLookAlikes(size_t every) {
  Scan scan = MakeScan(228.0 / 17);
  const auto wanted =
      std::find_if(scan.features.raw_pairs.begin(), scan.features.raw_pairs.end(),
                   [](const ImagePairMatches& pair) { return pair.image1 == 0 && pair.image2 == 1; });
  ImagePairMatches alike{0, 17, {}};
  const ScanImage& second = scan.features.images[1];
  ScanImage& last = scan.features.images[17];
  for (size_t m = 0; m < wanted->matches.size(); m += every) {
    const FeatureMatch& match = wanted->matches[m];
    alike.matches.push_back({match.point2D_idx1, static_cast<uint32_t>(last.keypoints.size())});
    last.keypoints.push_back(second.keypoints[match.point2D_idx2]);
    last.labels.push_back(second.labels[match.point2D_idx2]);
  }
  scan.features.raw_pairs.push_back(alike);
  return scan;
}

TEST(ScanEvidence, FewLookAlikesOverAGapSayNothingOfItsWidth) {
  const Scan scan = WithLookAlikes(3);
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_EQ(evidence.contradicted_seams, 1);
  EXPECT_EQ(evidence.seam.all, 0);
  EXPECT_EQ(evidence.far_pairs, 0);
  const ScanVerdict verdict = JudgeScan(evidence);
  EXPECT_EQ(verdict.verdict, Verdict::kGood) << verdict.reasons[0];
}

// As many as neighbours share: the poses may have lost that they are.
TEST(ScanEvidence, AsManyDetailsAsNeighboursShareOverAGapAreHeldAgainstIt) {
  const Scan scan = WithLookAlikes(1);
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_EQ(evidence.contradicted_seams, 1);
  EXPECT_GT(evidence.seam.all, 20);
  EXPECT_EQ(evidence.far_pairs, 1);
  EXPECT_NE(JudgeScan(evidence).verdict, Verdict::kGood);
}

// The second half of the angles, mirrored: the table went and came back the same way.
TEST(ScanEvidence, ATurnThatCameBackIsFound) {
  const Scan scan = MakeScan();
  TurntableScene scene = scan.turntable.scene;
  std::map<int, int> place;
  for (View& view : scene.views) {
    const int k = place[view.station]++;
    if (k < 9) continue;
    const double back_deg = 20.0 * (18 - k) - 20.0 * k;
    view.angle_deg += back_deg;
    view.world_from_object = TurnAbout(scene.axis, back_deg * kDegree) * view.world_from_object;
  }
  const ScanEvidence evidence = Gather(scan, scene);
  EXPECT_NE(JudgeScan(evidence).verdict, Verdict::kGood);
  EXPECT_EQ(evidence.misturned.empty() && evidence.turns_of_nothing == 0, false);
}

TurntableScene WithSteps(const TurntableScene& truth, double factor) {
  TurntableScene scene = truth;
  for (View& view : scene.views) {
    view.angle_deg *= factor;
    view.world_from_object = {
        Eigen::Quaterniond(Eigen::AngleAxisd(view.angle_deg * kPi / 180, scene.axis.direction)),
        Eigen::Vector3d::Zero()};
    view.world_from_object.translation =
        scene.axis.point - view.world_from_object.rotation * scene.axis.point;
  }
  return scene;
}

// Station 0's photos from the 5th to the 9th stand 3 degrees too far: the matches say so of the first of them
// and of the first after them, and by how much; neighbours still agree with most of their lines.
TEST(ScanEvidence, ABlockOfPhotosThatIsTurnedIsFound) {
  const Scan scan = MakeScan();
  TurntableScene scene = scan.turntable.scene;
  std::vector<std::string> names;
  for (View& view : scene.views) {
    if (view.station == 0) names.push_back(view.name);
    if (view.station != 0 || names.size() < 5 || names.size() > 9) continue;
    view.world_from_object = TurnAbout(scene.axis, 3 * kDegree) * view.world_from_object;
    view.angle_deg += 3;
  }
  const ScanEvidence evidence = Gather(scan, scene);
  EXPECT_EQ(evidence.contradicted_neighbours, 0);
  for (const size_t first : {size_t{4}, size_t{9}}) {
    EXPECT_EQ(std::count(evidence.misturned.begin(), evidence.misturned.end(), names[first]), 1) << first;
  }
  EXPECT_NEAR(evidence.worst_misturn_deg, 3, 1e-9);
  EXPECT_TRUE(evidence.untold.empty());
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
}

// Photos whose matches are all wrong stand where they stand by nothing that they show.
TEST(ScanEvidence, PhotosWithWrongMatchesDoNotTellTheirPlaces) {
  Scan scan = MakeScan();
  std::vector<std::string> names;
  const auto is_wrong = [](int image) { return image >= 3 && image < 8; };
  for (int image = 3; image < 8; ++image) names.push_back(scan.features.images[image].name);
  for (ImagePairMatches& pair : scan.features.raw_pairs) {
    if (!is_wrong(pair.image1) && !is_wrong(pair.image2)) continue;
    for (size_t m = 0; m < pair.matches.size() / 2; ++m) {
      std::swap(pair.matches[m].point2D_idx2, pair.matches[pair.matches.size() - 1 - m].point2D_idx2);
    }
  }
  const ScanEvidence evidence = Gather(scan, scan.turntable.scene);
  EXPECT_EQ(evidence.untold, names);
  EXPECT_TRUE(evidence.misturned.empty());
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kDoubtful);
  // Steps of the table tell them, if they are equal enough to tell one photo's place from another.
  const auto untold_in_steps = [&](double sigma_deg) {
    AlignedScene aligned;
    aligned.scene = scan.turntable.scene;
    aligned.object = SyntheticObjectModel(scan.turntable);
    EqualStepsPrior turn;
    turn.sigma_rad = sigma_deg * kDegree;
    for (size_t v = 0; v < aligned.scene.views.size(); ++v)
      turn.places.push_back({static_cast<int>(v), static_cast<double>(v)});
    return GatherEvidence(scan.features, aligned, JointReport(), {turn}, HoldBack(scan.features),
                          MatchFindings(), 4)
        .untold;
  };
  EXPECT_TRUE(untold_in_steps(1).empty());
  EXPECT_EQ(untold_in_steps(10), names);
}

TEST(ScanEvidence, StepsThatAreTooLongDoNotClose) {
  const Scan scan = MakeScan();
  const ScanEvidence evidence = Gather(scan, WithSteps(scan.turntable.scene, 1.06));
  EXPECT_LT(*evidence.seam.Share(), 0.5);
  EXPECT_NE(JudgeScan(evidence).verdict, Verdict::kGood);
}

// Stations that no background ties have table angles that nobody can tell, and may show the object well.
TEST(ScanEvidence, StationsWithoutABackgroundAreAsSureAsTheObjectTells) {
  const Scan scan = MakeScan();
  AlignedScene aligned;
  aligned.scene = scan.turntable.scene;
  aligned.object = SyntheticObjectModel(scan.turntable);
  JointReport joint;
  joint.observability.computed = true;
  for (const View& view : aligned.scene.views)
    joint.angle_sigma_deg.push_back(view.station == 1 ? std::numeric_limits<double>::infinity() : 0.02);
  const auto worst = [&](const MatchFindings& findings) {
    return *GatherEvidence(scan.features, aligned, joint, {}, HoldBack(scan.features), findings, 4)
                .angle_sigma_max_deg;
  };
  MatchFindings findings;
  EXPECT_TRUE(std::isinf(worst(findings)));
  joint.turn_sigma_deg.assign(aligned.scene.views.size(), 0.3);
  EXPECT_TRUE(std::isinf(worst(findings)));  // matches have not been asked
  findings.turn_sigma_deg[1] = 0.2;
  EXPECT_EQ(worst(findings), 0.3);
  findings.turn_sigma_deg[1] = 0.4;
  EXPECT_EQ(worst(findings), 0.4);
  joint.model = JointModel::kFreeObject;  // of which they are not
  EXPECT_EQ(worst({}), 0.3);
  aligned.background = SyntheticStaticModel(scan.turntable);
  EXPECT_TRUE(std::isinf(worst(findings)));
}

// Of 36 photos, from an arc around a body.
std::vector<Rigid3> AroundABody(double arc_deg) {
  std::vector<Rigid3> poses;
  for (int i = 0; i < 36; ++i) {
    poses.push_back(
        {Eigen::Quaterniond(Eigen::AngleAxisd(arc_deg * kDegree * i / 36, Eigen::Vector3d::UnitY())),
         Eigen::Vector3d(0, 0, 1)});
  }
  return poses;
}

// Nothing turns in what was matched, but the camera stood still: SfM's model is of the background.
TEST(ScanEvidence, OneBodyBeforeACameraThatStoodStillHasFailed) {
  Scan scan = MakeScan();
  const auto judge = [&](double arc_deg) {
    return JudgeScan(GatherOneBodyEvidence(scan.features, {}, AroundABody(arc_deg))).verdict;
  };
  EXPECT_EQ(judge(360), Verdict::kFailed);
  for (size_t i = 0; i < scan.features.images.size(); ++i)
    scan.features.images[i].station = static_cast<int>(i);
  EXPECT_EQ(judge(360), Verdict::kGood);
  // So it may be where a hand held the camera before a table that was not seen to turn.
  EXPECT_EQ(judge(50), Verdict::kDoubtful);
  EXPECT_EQ(judge(150), Verdict::kGood);
}

TEST(ScanEvidence, ATableThatHardlyTurnsCannotMoveItsObjectSoFar) {
  const Scan scan = MakeScan();
  const ScanEvidence evidence = Gather(scan, WithSteps(scan.turntable.scene, 0.05));
  EXPECT_LT(std::abs(*evidence.median_step_deg), *evidence.least_step_deg);
  EXPECT_EQ(JudgeScan(evidence).verdict, Verdict::kFailed);
}

}  // namespace
}  // namespace s2gs
