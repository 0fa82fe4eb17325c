#include "tests/support/option_bounds.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/circular_motion/circular_motion.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/match_images.h"
#include "sfm_split/placement/place_scan.h"
#include "sfm_split/relocalise/guided_registration.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/single_axis/single_axis.h"
#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/stations.h"
#include "sfm_split/split/two_view_motion.h"
#include "sfm_split/turntable/turntable.h"

namespace s2gs {
namespace {

constexpr double kTiny = 1e-9;  // a number that "%f" shows as 0.000000
constexpr double kInf = std::numeric_limits<double>::infinity();
const double kNan = std::nan("");

TEST(OptionBounds, Matching) {
  using D = DescriptorMatchOptions;
  ExpectBounds(D(), &D::max_ratio, "max_ratio", {kTiny, 1.0}, {0.0, -kTiny, 1.1, kNan});
  ExpectBounds(D(), &D::max_distance, "max_distance", {kTiny, 1e9}, {0.0, -kTiny, kInf, kNan});
  using M = MatchImagesOptions;
  ExpectBounds(M(), &M::num_threads, "num_threads", {0, 7}, {-1});
  ExpectBounds(M(), &M::cache_size_gb, "cache_size_gb", {kTiny, 1e6}, {0.0, -kTiny, 1.1e6, kNan});
  M inner;
  inner.match.max_ratio = 2;
  ASSERT_TRUE(inner.Check());
  EXPECT_EQ(inner.Check()->field, "max_ratio");
}

TEST(OptionBounds, Split) {
  using S = MotionSplitOptions;
  ExpectBounds(S(), &S::min_static_support, "min_static_support", {1}, {0});
  ExpectBounds(S(), &S::max_object_steps, "max_object_steps", {1}, {0});
  ExpectBounds(S(), &S::station_partners, "station_partners", {1}, {0});
  ExpectBounds(S(), &S::max_nearby_stations, "max_nearby_stations", {1}, {0});
  ExpectBounds(S(), &S::min_rotating_matches, "min_rotating_matches", {1}, {0});
  ExpectBounds(S(), &S::max_exhaustive_pairs, "max_exhaustive_pairs", {1}, {0});
  ExpectBounds(S(), &S::min_moved_px, "min_moved_px", {kTiny}, {0.0, -kTiny, kNan});
  using T = TwoViewMotionOptions;
  ExpectBounds(T(), &T::max_error_px, "max_error_px", {kTiny}, {0.0, -kTiny, kNan});
  ExpectBounds(T(), &T::confidence, "confidence", {kTiny, 0.5}, {0.0, 1.0, kNan});
  ExpectBounds(T(), &T::max_iterations, "max_iterations", {1}, {0});
  ExpectBounds(T(), &T::min_inliers, "min_inliers", {8}, {7});
  ExpectBounds(T(), &T::max_motions, "max_motions", {1}, {0});
  using O = StationOptions;
  ExpectBounds(O(), &O::max_unmoved_px, "max_unmoved_px", {kTiny}, {0.0, -kTiny, kNan});
  ExpectBounds(O(), &O::max_shake_px, "max_shake_px", {0.0, 100.0}, {-kTiny, 100.5, kNan});
  ExpectBounds(O(), &O::min_unmoved_matches, "min_unmoved_matches", {4}, {3});
  ExpectBounds(O(), &O::min_unmoved_share, "min_unmoved_share", {0.0, 1.0}, {-kTiny, 1.5, kNan});
  ExpectBounds(O(), &O::min_cells, "min_cells", {1, 64}, {0, 65});
}

TEST(OptionBounds, TableAndAngles) {
  using T = TurntableOptions;
  ExpectBounds(T(), &T::max_seeds, "max_seeds", {1}, {0});
  ExpectBounds(T(), &T::max_seed_error_deg, "max_seed_error_deg", {kTiny}, {0.0, kNan});
  ExpectBounds(T(), &T::max_seed_error_rel, "max_seed_error_rel", {kTiny}, {0.0, kNan});
  ExpectBounds(T(), &T::inlier_sigmas, "inlier_sigmas", {2.0}, {1.5, kNan});
  ExpectBounds(T(), &T::min_outlier_deg, "min_outlier_deg", {0.0}, {-kTiny, kNan});
  ExpectBounds(T(), &T::min_outlier_rel, "min_outlier_rel", {0.0}, {-kTiny, kNan});
  ExpectBounds(T(), &T::max_axis_sigma_deg, "max_axis_sigma_deg", {kTiny}, {0.0, kNan});
  ExpectBounds(T(), &T::max_scale_sigma_rel, "max_scale_sigma_rel", {kTiny}, {0.0, kNan});
  ExpectBounds(T(), &T::known_scale, "known_scale", {kTiny}, {0.0, -kTiny, kNan});
  using S = SingleAxisOptions;
  ExpectBounds(S(), &S::noise_px, "noise_px", {kTiny}, {0.0, kNan});
  ExpectBounds(S(), &S::min_matches, "min_matches", {3}, {2});
  ExpectBounds(S(), &S::max_search_pairs, "max_search_pairs", {1}, {0});
  ExpectBounds(S(), &S::max_search_matches, "max_search_matches", {3}, {2});
  ExpectBounds(S(), &S::num_directions, "num_directions", {1}, {0});
  ExpectBounds(S(), &S::offsets_per_side, "offsets_per_side", {1}, {0});
  ExpectBounds(S(), &S::num_refined, "num_refined", {1}, {0});
  ExpectBounds(S(), &S::max_matches, "max_matches", {3}, {2});
  using C = CircularOptions;
  ExpectBounds(C(), &C::noise_px, "noise_px", {kTiny}, {0.0, kNan});
  ExpectBounds(C(), &C::max_matches, "max_matches", {3}, {2});
  ExpectBounds(C(), &C::num_refined, "num_refined", {1}, {0});
  ExpectBounds(C(), &C::min_photos, "min_photos", {3}, {2});
}

TEST(OptionBounds, Adjustment) {
  using J = JointOptions;
  ExpectBounds(J(), &J::loss_scale_px, "loss_scale_px", {0.0}, {-kTiny, kNan});
  ExpectBounds(J(), &J::max_reprojection_error_px, "max_reprojection_error_px", {kTiny}, {0.0, kNan});
  ExpectBounds(J(), &J::min_triangulation_deg, "min_triangulation_deg", {0.0}, {-kTiny, kNan});
  ExpectBounds(J(), &J::max_rounds, "max_rounds", {1}, {0});
  ExpectBounds(J(), &J::max_iterations, "max_iterations", {1}, {0});
  ExpectBounds(J(), &J::function_tolerance, "function_tolerance", {0.0}, {-kTiny, kNan});
  ExpectBounds(J(), &J::min_free_observations, "min_free_observations", {3}, {2});
  ExpectBounds(J(), &J::num_threads, "num_threads", {0}, {-1});
  using T = TrackOptions;
  ExpectBounds(T(), &T::max_error_px, "max_error_px", {kTiny}, {0.0, kNan});
  ExpectBounds(T(), &T::min_triangulation_deg, "min_triangulation_deg", {kTiny, 89.9}, {0.0, 90.0, kNan});
  ExpectBounds(T(), &T::max_hypotheses, "max_hypotheses", {1}, {0});
}

TEST(OptionBounds, Relocalisation) {
  using P = PlacementOptions;
  ExpectBounds(P(), &P::enough_share, "enough_share", {0.0, 1.0}, {-kTiny, 1.5, kNan});
  ExpectBounds(P(), &P::max_noise_growth, "max_noise_growth", {1.0}, {0.5, kNan});
  ExpectBounds(P(), &P::least_noise_px, "least_noise_px", {kTiny}, {0.0, kNan});
  using R = RefineOptions;
  ExpectBounds(R(), &R::noise_px, "noise_px", {0.0}, {-kTiny, kNan});
  ExpectBounds(R(), &R::max_rounds, "max_rounds", {1}, {0});
  ExpectBounds(R(), &R::max_error_px, "max_error_px", {kTiny}, {0.0, kNan});
  ExpectBounds(R(), &R::min_triangulation_deg, "min_triangulation_deg", {kTiny, 89.9}, {0.0, 90.0, kNan});
  ExpectBounds(R(), &R::min_relocalise_inliers, "min_relocalise_inliers", {3}, {2});
  ExpectBounds(R(), &R::min_relocalise_share, "min_relocalise_share", {0.0, 1.0}, {-kTiny, 1.5, kNan});
  ExpectBounds(R(), &R::max_adjusted_observations, "max_adjusted_observations", {1000}, {999});
  ExpectBounds(R(), &R::max_adjusted_background, "max_adjusted_background", {50}, {49});
  using G = GuidedOptions;
  ExpectBounds(G(), &G::max_looks, "max_looks", {1}, {0});
  ExpectBounds(G(), &G::num_candidates, "num_candidates", {1}, {0});
  ExpectBounds(G(), &G::max_distance_rad, "max_distance_rad", {kTiny, 1.57}, {0.0, kPi / 2, kNan});
  ExpectBounds(G(), &G::max_view_change_deg, "max_view_change_deg", {kTiny, 180.0}, {0.0, 180.5, kNan});
  ExpectBounds(G(), &G::max_error_px, "max_error_px", {kTiny}, {0.0, kNan});
  ExpectBounds(G(), &G::window_px, "window_px", {kTiny}, {0.0, kNan});
  ExpectBounds(G(), &G::min_inliers, "min_inliers", {3}, {2});
  ExpectBounds(G(), &G::min_margin, "min_margin", {1.0}, {0.5, kNan});
  ExpectBounds(G(), &G::max_chance, "max_chance", {kTiny, 1.0}, {0.0, 1.5, kNan});
}

}  // namespace
}  // namespace s2gs
