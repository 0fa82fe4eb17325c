#include "mesh/light/turn_light.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "s2gs/image/srgb.h"
#include "s2gs/kernel/wigner_d.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Terms = Eigen::Matrix<double, kLightTerms, 1>;
using Turn = Eigen::Matrix<float, kLightTerms, kLightTerms>;

// What is darker beside its mean is noise more than light.
constexpr float kLeastShade = 1.0F / 16;
// A table that turns less than a photo's step does is no table.
constexpr double kLeastTurnDeg = 2;
// 48 numbers from so many values are known far better than the model is right.
constexpr size_t kMaxSamples = 400'000;
constexpr int kRounds = 12;
// Of the mean of the equations' diagonal: what no place tells apart stays near 0.
constexpr double kRidge = 1e-5;
constexpr int kJudgeEvery = 5;
constexpr int kJudge = 2;

// Harmonics of the world at turned directions: basis(R d) = D basis(d).
Turn TurnOf(const Eigen::Matrix3d& r) {
  const WignerD<double> d(
      Mat3<double>{{r(0, 0), r(1, 0), r(2, 0)}, {r(0, 1), r(1, 1), r(2, 1)}, {r(0, 2), r(1, 2), r(2, 2)}});
  Turn turn = Turn::Identity();
  for (int i = 1; i < kLightTerms; ++i) {
    for (int j = 1; j < kLightTerms; ++j) turn(i, j) = static_cast<float>(d(i - 1, j - 1));
  }
  return turn;
}

// One channel's light and the places' colours under it.
class ChannelFit {
 public:
  struct Sample {
    uint32_t place;
    uint32_t photo;
    float value;       // sRGB, 0 to 255
    float light;       // the same as light, 0 to 1
    LightTerms terms;  // of the world's light
    bool judges;
  };
  explicit ChannelFit(const std::vector<Sample>& samples) : samples_(samples) {
    for (const Sample& s : samples_) num_places_ = std::max<size_t>(num_places_, s.place + size_t{1});
  }

  // Without the photos that judge, or with all. \param is_lit  false: even light.
  Terms Fit(bool with_judges, bool is_lit) {
    with_judges_ = with_judges;
    Terms light = Terms::Zero();
    light[0] = 1;
    shades_.assign(samples_.size(), 1);
    if (is_lit) Shine(&light);
    weights_.assign(samples_.size(), 1);
    for (int round = 0; round < kRounds; ++round) {
      SolveColors();
      if (is_lit) {
        SolveLight(&light);
        Shine(&light);
        SolveColors();
      }
      Weigh();
    }
    return light;
  }

  // Of the photos that judge, at places that others show [grey values].
  double JudgesError() const {
    std::vector<double> errors;
    for (size_t i = 0; i < samples_.size(); ++i) {
      if (!IsJudge(samples_[i]) || !samples_[i].judges || !(color_weights_[samples_[i].place] > 0)) continue;
      errors.push_back(std::abs(Error(i)));
    }
    return errors.empty() ? 0 : UpperMedian(errors);
  }

 private:
  static bool IsJudge(const Sample& s) { return s.photo % kJudgeEvery == kJudge; }
  bool IsUsed(const Sample& s) const { return with_judges_ || !IsJudge(s); }

  double Error(size_t i) const {
    const double light = std::max(0.0, colors_[samples_[i].place] * shades_[i]);
    return 255 * SrgbFromLight(light) - samples_[i].value;
  }

  void SolveColors() {
    colors_.assign(num_places_, 0);
    color_weights_.assign(num_places_, 0);
    for (size_t i = 0; i < samples_.size(); ++i) {
      if (!IsUsed(samples_[i])) continue;
      colors_[samples_[i].place] += weights_[i] * shades_[i] * samples_[i].light;
      color_weights_[samples_[i].place] += weights_[i] * shades_[i] * shades_[i];
    }
    for (size_t k = 0; k < num_places_; ++k) {
      if (color_weights_[k] > 0) colors_[k] /= color_weights_[k];
    }
  }

  void SolveLight(Terms* light) const {
    Eigen::Matrix<double, kLightTerms, kLightTerms> matrix;
    matrix.setZero();
    Terms right = Terms::Zero();
    for (size_t i = 0; i < samples_.size(); ++i) {
      if (!IsUsed(samples_[i])) continue;
      const double color = colors_[samples_[i].place];
      const Terms terms = samples_[i].terms.cast<double>();
      matrix.selfadjointView<Eigen::Lower>().rankUpdate(terms, weights_[i] * color * color);
      right += weights_[i] * color * samples_[i].light * terms;
    }
    matrix.diagonal().array() += kRidge * matrix.trace() / kLightTerms;
    *light = matrix.selfadjointView<Eigen::Lower>().ldlt().solve(right);
  }

  // Light of mean 1, so that colours keep their size.
  void Shine(Terms* light) {
    double sum = 0;
    for (size_t i = 0; i < samples_.size(); ++i) {
      shades_[i] = light->dot(samples_[i].terms.cast<double>());
      sum += shades_[i];
    }
    const double mean = sum / static_cast<double>(samples_.size());
    if (!(mean > 0)) return;
    *light /= mean;
    for (double& shade : shades_) shade = std::max<double>(kLeastShade, shade / mean);
  }

  // Errors are alike in grey values; gloss and what stands in front are none of the light's.
  void Weigh() {
    std::vector<double> errors;
    errors.reserve(samples_.size());
    for (size_t i = 0; i < samples_.size(); ++i) {
      if (IsUsed(samples_[i])) errors.push_back(std::abs(Error(i)));
    }
    const double sigma = std::max(kLeastLightSigma, kSigmaOfMad * UpperMedian(errors));
    for (size_t i = 0; i < samples_.size(); ++i) {
      const double x = Error(i) / (kLightCauchy * sigma);
      const double slope = SrgbSlope<double>(samples_[i].light);
      weights_[i] = slope * slope / (1 + x * x);
    }
  }

  const std::vector<Sample>& samples_;
  size_t num_places_ = 0;
  bool with_judges_ = true;
  std::vector<double> colors_;
  std::vector<double> color_weights_;
  std::vector<double> shades_;
  std::vector<double> weights_;
};

}  // namespace

bool Turns(const std::vector<Eigen::Matrix3d>& world_from_object) {
  return std::any_of(world_from_object.begin(), world_from_object.end(), [&](const Eigen::Matrix3d& r) {
    return Eigen::AngleAxisd(Eigen::Matrix3d(world_from_object.front().transpose() * r)).angle() >
           kLeastTurnDeg * kPi / 180;
  });
}

TurnLight::TurnLight(const Eigen::Matrix<double, kLightTerms, 3>& in_world,
                     const std::vector<Eigen::Matrix3d>& world_from_object)
    : is_even_(false), in_world_(in_world) {
  for (const Eigen::Matrix3d& rotation : world_from_object) mean_ += Turned(rotation);
  mean_ /= static_cast<float>(world_from_object.size());
}

PhotoLight TurnLight::Turned(const Eigen::Matrix3d& world_from_object) const {
  return TurnOf(world_from_object).transpose() * in_world_.cast<float>();
}

Eigen::Array3f TurnLight::Shade(const PhotoLight& light, const LightTerms& transfer) const {
  if (is_even_) return Eigen::Array3f::Ones();
  const Eigen::Array3f mean = (mean_.transpose() * transfer).array();
  const Eigen::Array3f here = (light.transpose() * transfer).array();
  Eigen::Array3f shade = Eigen::Array3f::Ones();
  for (int c = 0; c < 3; ++c) {
    // Where hardly any light arrives at all nothing is known of it.
    if (mean[c] > 0) shade[c] = std::clamp(here[c] / mean[c], kLeastShade, 1 / kLeastShade);
  }
  return shade;
}

LightFinding FitTurnLight(const std::vector<LitSample>& samples, const std::vector<LightTerms>& transfers,
                          const std::vector<Eigen::Matrix3d>& world_from_object, int num_threads) {
  LightFinding finding;
  if (samples.empty() || !Turns(world_from_object)) return finding;
  std::vector<Turn> turns;
  turns.reserve(world_from_object.size());
  for (const Eigen::Matrix3d& rotation : world_from_object) turns.push_back(TurnOf(rotation));
  const size_t stride = (samples.size() + kMaxSamples - 1) / kMaxSamples;
  // Of grey photos one channel tells all.
  const bool are_grey = std::all_of(samples.begin(), samples.end(), [](const LitSample& s) {
    return s.color[0] == s.color[1] && s.color[0] == s.color[2];
  });
  const int num_channels = are_grey ? 1 : 3;
  std::vector<std::vector<ChannelFit::Sample>> of_channel(num_channels);
  for (const LitSample& s : samples) {
    if (s.place % stride != 0 || s.color.maxCoeff() > kBrightestGrey) continue;
    const LightTerms terms = turns[s.photo] * transfers[s.place];
    for (int c = 0; c < num_channels; ++c) {
      of_channel[c].push_back(
          {s.place, s.photo, s.color[c], LightFromSrgb(s.color[c] / 255), terms, s.judges});
    }
  }
  if (of_channel[0].empty()) return finding;
  // Of each channel: even light and light without the photos that judge, and light of all photos.
  Eigen::Matrix<double, kLightTerms, 3> in_world;
  std::vector<double> error_even(num_channels, 0);
  std::vector<double> error_lit(num_channels, 0);
  ParallelFor(3 * num_channels, num_threads, [&](int64_t job) {
    const auto c = static_cast<size_t>(job % num_channels);
    ChannelFit fit(of_channel[c]);
    // The longest first.
    if (job < num_channels) {
      in_world.col(static_cast<int>(c)) = fit.Fit(true, true);
      return;
    }
    const bool is_lit = job < 2 * num_channels;
    fit.Fit(false, is_lit);
    (is_lit ? error_lit : error_even)[c] = fit.JudgesError();
  });
  for (int c = 0; c < num_channels; ++c) {
    finding.error_even += error_even[c] / num_channels;
    finding.error_lit += error_lit[c] / num_channels;
  }
  for (int c = num_channels; c < 3; ++c) in_world.col(c) = in_world.col(0);
  if (finding.error_lit < finding.error_even) finding.light = TurnLight(in_world, world_from_object);
  return finding;
}

Eigen::Array3f UnderLight(const Eigen::Array3f& srgb, const Eigen::Array3f& shade) {
  Eigen::Array3f lit = srgb;
  for (int c = 0; c < 3; ++c) {
    if (shade[c] != 1) lit[c] = 255 * SrgbFromLight(shade[c] * LightFromSrgb(srgb[c] / 255));
  }
  return lit;
}

}  // namespace s2gs
