#include "tests/support/option_bounds.h"

#include <gtest/gtest.h>

#include <cmath>

#include "s2gs/initialise.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/train_options.h"

namespace s2gs {
namespace {

constexpr double kTiny = 1e-9;  // a number that "%f" shows as 0.000000
const double kNan = std::nan("");

// From 0 on, without a bound above.
void ExpectAtLeastZero(double TrainOptions::*field, const char* name) {
  ExpectBounds(TrainOptions(), field, name, {0.0, 1e3}, {-kTiny, kNan});
}
// From 0 to 1, both included.
void ExpectShare(double TrainOptions::*field, const char* name) {
  ExpectBounds(TrainOptions(), field, name, {0.0, 1.0}, {-kTiny, 1 + kTiny, kNan});
}

TEST(OptionBounds, LearningRates) {
  using T = TrainOptions;
  ExpectBounds(T(), &T::centre_rate, "centre_rate", {1.0}, {-kTiny, kNan});
  ExpectBounds(T(), &T::final_centre_rate, "final_centre_rate", {0.0, T().centre_rate},
               {-kTiny, 2 * T().centre_rate, kNan});
  ExpectAtLeastZero(&T::scale_rate, "scale_rate");
  ExpectAtLeastZero(&T::rotation_rate, "rotation_rate");
  ExpectAtLeastZero(&T::opacity_rate, "opacity_rate");
  ExpectAtLeastZero(&T::sh_dc_rate, "sh_dc_rate");
  ExpectAtLeastZero(&T::sh_rest_rate, "sh_rest_rate");
  ExpectAtLeastZero(&T::foreground_rate, "foreground_rate");
}

TEST(OptionBounds, TermsOfTheLoss) {
  using T = TrainOptions;
  ExpectShare(&T::dssim_weight, "dssim_weight");
  ExpectAtLeastZero(&T::normal_weight, "normal_weight");
  ExpectShare(&T::normal_from, "normal_from");
  ExpectAtLeastZero(&T::distortion_weight, "distortion_weight");
  ExpectShare(&T::distortion_from, "distortion_from");
  ExpectAtLeastZero(&T::local_consistency_weight, "local_consistency_weight");
  ExpectAtLeastZero(&T::entropy_3d_weight, "entropy_3d_weight");
  ExpectAtLeastZero(&T::entropy_2d_weight, "entropy_2d_weight");
  ExpectAtLeastZero(&T::mask_weight, "mask_weight");
  ExpectShare(&T::regularise_from, "regularise_from");
  ExpectBounds(T(), &T::num_neighbours, "num_neighbours", {1, 64}, {0, 65});
  ExpectBounds(T(), &T::neighbours_every, "neighbours_every", {1e-5, 1.0}, {0.9e-5, 1.1, kNan});
}

TEST(OptionBounds, Growth) {
  using T = TrainOptions;
  ExpectBounds(T(), &T::sh_degree, "sh_degree", {0, 3}, {-1, 4});
  ExpectShare(&T::sh_degree_every, "sh_degree_every");
  ExpectBounds(T(), &T::max_gaussians, "max_gaussians", {1.0, 1e9}, {0.0, -1.0});
  ExpectShare(&T::densify_from, "densify_from");
  ExpectShare(&T::densify_until, "densify_until");
  ExpectBounds(T(), &T::densify_every, "densify_every", {1}, {0});
  ExpectAtLeastZero(&T::densify_gradient, "densify_gradient");
  ExpectAtLeastZero(&T::dense_scale, "dense_scale");
  ExpectBounds(T(), &T::min_opacity, "min_opacity", {0.0, 0.99}, {-kTiny, 0.991, kNan});
  ExpectShare(&T::opacity_reset_every, "opacity_reset_every");
  ExpectBounds(T(), &T::opacity_reset_to, "opacity_reset_to", {1e-4, 0.99}, {0.9e-4, 0.991, kNan});
  ExpectAtLeastZero(&T::max_normalised_scale, "max_normalised_scale");
}

TEST(OptionBounds, Course) {
  using T = TrainOptions;
  ExpectBounds(T(), &T::num_iterations, "num_iterations", {1.0, 1e9}, {0.0, -1.0});
  ExpectAtLeastZero(&T::max_seconds, "max_seconds");
  ExpectBounds(T(), &T::stop_gain_pct, "stop_gain_pct", {0.0, 100.0}, {-kTiny, 100.1, kNan});
  ExpectBounds(T(), &T::settle_from, "settle_from", {0.0}, {-kTiny, 1.1, kNan});
  ExpectBounds(T(), &T::settle_until, "settle_until", {T().settle_from, 1.0},
               {T().settle_from - 0.01, 1.1, kNan});
  ExpectShare(&T::settled_share, "settled_share");
  ExpectShare(&T::unseen_weight, "unseen_weight");
  ExpectShare(&T::unseen_static_weight, "unseen_static_weight");
  ExpectBounds(T(), &T::coarse_levels, "coarse_levels", {0, 6}, {-1, 7});
  ExpectShare(&T::coarse_until, "coarse_until");
  ExpectBounds(T(), &T::min_coarse_size, "min_coarse_size", {16}, {15});
  ExpectShare(&T::checkpoint_every, "checkpoint_every");
  ExpectBounds(T(), &T::num_measurements, "num_measurements", {0, 1000}, {-1, 1001});
}

TEST(OptionBounds, FirstGaussiansAndScene) {
  using I = InitialiseOptions;
  ExpectBounds(I(), &I::num_random_points, "num_random_points", {1}, {0});
  ExpectBounds(I(), &I::min_points, "min_points", {1}, {0});
  ExpectBounds(I(), &I::max_points, "max_points", {1}, {0});
  ExpectBounds(I(), &I::opacity, "opacity", {kTiny, 0.999}, {0.0, 1.0, kNan});
  ExpectBounds(I(), &I::random_foreground, "random_foreground", {kTiny, 0.999}, {0.0, 1.0, kNan});
  ExpectBounds(I(), &I::sparse_foreground, "sparse_foreground", {0.5, 0.999}, {0.499, 1.0, kNan});
  ExpectBounds(I(), &I::background_radius_sides, "background_radius_sides", {kTiny}, {0.0, -kTiny, kNan});
  TrainOptions options;
  options.initial.opacity = 1;
  ASSERT_TRUE(options.Check());
  EXPECT_EQ(options.Check()->field, "opacity");
  using S = TrainingSceneOptions;
  ExpectBounds(S(), &S::max_image_size, "max_image_size", {16}, {15});
  ExpectBounds(S(), &S::max_test_size, "max_test_size", {0, 16}, {15, 1, -1});
  ExpectBounds(S(), &S::test_every, "test_every", {0, 2}, {1, -1});
}

}  // namespace
}  // namespace s2gs
