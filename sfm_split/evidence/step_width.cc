#include "sfm_split/evidence/step_width.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/evidence/turn_likelihood.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

constexpr size_t kLeastImages = 6;        // of a station: offset, step and some scatter
constexpr double kHalf = 0.5;             // of a step: farther it is the next photo's place
constexpr double kFirstTurnDeg = 0.02;    // finer than angles are known
constexpr double kTurnFactor = 1.4;       // between turns that are tried
constexpr double kLastTurnDeg = 60;       // of photos that stand some steps off
constexpr double kLeastWidthDeg = 0.01;   // half of the first turn
constexpr double kWidthFactor = 1.1;      // between widths that are tried
constexpr double kMostWidthDeg = 1;       // of steps that somebody would call equal, by marks and by hand
constexpr double kAnywhere = 0.1;         // of photos, whose matches may put them anywhere
constexpr double kLeastElsewhereDeg = 1;  // what is asked of a table angle

// From the middle out to either side, in order.
std::vector<double> TurnsDeg() {
  std::vector<double> turns = {0};
  for (double turn = kFirstTurnDeg; turn <= kLastTurnDeg; turn *= kTurnFactor) {
    turns.push_back(turn);
    turns.push_back(-turn);
  }
  std::sort(turns.begin(), turns.end());
  return turns;
}

double NormalBelow(double value, double sigma) { return 0.5 * std::erfc(-value / (sigma * std::sqrt(2.0))); }

// The mean of a likelihood over deviations of a width; the turns stand for what is nearest to them.
double LogMean(const std::vector<double>& turns_deg, const std::vector<double>& log_likelihoods,
               double width_deg) {
  const double highest = *std::max_element(log_likelihoods.begin(), log_likelihoods.end());
  double sum = 0;
  double below = 0;
  for (size_t t = 0; t < turns_deg.size(); ++t) {
    const double up_to =
        t + 1 < turns_deg.size() ? NormalBelow((turns_deg[t] + turns_deg[t + 1]) / 2, width_deg) : 1;
    sum += (up_to - below) * std::exp(log_likelihoods[t] - highest);
    below = up_to;
  }
  return highest + std::log(std::max(sum, 1e-300));
}

// The same over any angle of the table; those beyond the turns are worth what the poses are.
double LogMeanAnywhere(const std::vector<double>& turns_deg, const std::vector<double>& log_likelihoods) {
  const double highest = std::max(0.0, *std::max_element(log_likelihoods.begin(), log_likelihoods.end()));
  double sum = (360 - (turns_deg.back() - turns_deg.front())) * std::exp(-highest);
  for (size_t t = 1; t < turns_deg.size(); ++t) {
    const double mean =
        0.5 * (std::exp(log_likelihoods[t] - highest) + std::exp(log_likelihoods[t - 1] - highest));
    sum += mean * (turns_deg[t] - turns_deg[t - 1]);
  }
  return highest + std::log(sum / 360);
}

// The mean of the width over what the matches say of it, so that a normal deviation of this width is off by
// as much in the mean as one of a width that is not known; before the matches are looked at, all orders of
// magnitude of the width are alike. Where matches tell nothing that is a fifth of the widest: nobody has
// shown the steps to be more equal. Every pair of photos is in the likelihoods of both of them and counts by
// half in each. A photo may be anywhere, so that wrong matches that agree by themselves decide nothing.
double ExpectedWidth(const std::vector<double>& turns_deg,
                     const std::vector<std::vector<double>>& log_likelihoods) {
  std::vector<double> anywhere;
  anywhere.reserve(log_likelihoods.size());
  for (const std::vector<double>& of_photo : log_likelihoods)
    anywhere.push_back(std::log(kAnywhere) + LogMeanAnywhere(turns_deg, of_photo));
  std::vector<double> widths;
  std::vector<double> posterior;
  for (double width = kLeastWidthDeg; width <= kMostWidthDeg; width *= kWidthFactor) {
    double sum = 0;
    for (size_t k = 0; k < log_likelihoods.size(); ++k) {
      const double about = std::log(1 - kAnywhere) + LogMean(turns_deg, log_likelihoods[k], width);
      const double highest = std::max(about, anywhere[k]);
      sum += 0.5 * (highest + std::log(std::exp(about - highest) + std::exp(anywhere[k] - highest)));
    }
    widths.push_back(width);
    posterior.push_back(sum);
  }
  const double highest = *std::max_element(posterior.begin(), posterior.end());
  double all = 0;
  for (double& value : posterior) {
    value = std::exp(value - highest);
    all += value;
  }
  double mean = 0;
  for (size_t k = 0; k < widths.size(); ++k) mean += posterior[k] / all * widths[k];
  return mean;
}

// The constant from which the angles differ least, by the median of their distances.
double NearestConstant(const std::vector<double>& angles) {
  double best = 0;
  double least = 1e300;
  for (const double candidate : angles) {
    std::vector<double> off;
    off.reserve(angles.size());
    for (const double angle : angles) off.push_back(std::abs(WrapAngle(angle - candidate)));
    const double median = UpperMedian(std::move(off));
    if (median >= least) continue;
    least = median;
    best = candidate;
  }
  std::vector<double> off;
  off.reserve(angles.size());
  for (const double angle : angles) off.push_back(WrapAngle(angle - best));
  return best + UpperMedian(std::move(off));
}

// Each photo's matches by its turn from its place.
std::vector<std::vector<double>> TurnsOfPhotos(const std::vector<TurnPair>& pairs,
                                               const TurnLikelihood& likelihood,
                                               const std::vector<int>& images,
                                               const std::vector<double>& turns_deg) {
  std::map<size_t, size_t> place;
  for (size_t k = 0; k < images.size(); ++k) place[static_cast<size_t>(images[k])] = k;
  std::vector<std::vector<double>> of_photo(images.size(), std::vector<double>(turns_deg.size(), 0));
  const double noise = likelihood.Noise(pairs);
  const size_t middle = turns_deg.size() / 2;
  for (const TurnPair& pair : pairs) {
    const std::vector<double> gains = likelihood.OfTurns(pair, turns_deg, noise);
    for (size_t t = 0; t < gains.size(); ++t) {
      of_photo[place[pair.image2]][t] += gains[t] - gains[middle];
      of_photo[place[pair.image1]][gains.size() - 1 - t] += gains[t] - gains[middle];
    }
  }
  return of_photo;
}

}  // namespace

EqualStepsPrior NearestEqualSteps(const std::vector<AngleAtPlace>& given, int num_photos) {
  EqualStepsPrior result;
  std::vector<AngleAtPlace> angles = given;
  std::sort(angles.begin(), angles.end(),
            [](const AngleAtPlace& a, const AngleAtPlace& b) { return a.place < b.place; });
  std::vector<double> single;
  for (size_t k = 1; k < angles.size(); ++k) {
    if (angles[k].place - angles[k - 1].place == 1)
      single.push_back(WrapAngle(angles[k].angle_rad - angles[k - 1].angle_rad));
  }
  if (angles.size() < kLeastImages || 2 * single.size() < angles.size()) return result;
  double step = UpperMedian(single);
  const double whole = (step < 0 ? -2 : 2) * kPi / num_photos;
  const auto offsets = [&](double of_step) {
    std::vector<double> values;
    values.reserve(angles.size());
    for (const AngleAtPlace& angle : angles)
      values.push_back(WrapAngle(angle.angle_rad - of_step * angle.place));
    return values;
  };
  result.closes = std::abs(step - whole) * num_photos < kHalf * std::abs(whole);
  if (result.closes) {
    step = whole;
  } else {
    // Open steps are refined by the line through all angles, which have to follow it.
    double sum_p = 0;
    double sum_r = 0;
    double sum_pp = 0;
    double sum_pr = 0;
    double residual = 0;
    const double start = angles[0].angle_rad - step * angles[0].place;
    for (const AngleAtPlace& angle : angles) {
      const double r = angle.angle_rad - start - step * angle.place;
      residual += WrapAngle(r - residual);  // continues from the one before
      sum_p += angle.place;
      sum_r += residual;
      sum_pp += static_cast<double>(angle.place) * angle.place;
      sum_pr += residual * angle.place;
    }
    const auto num = static_cast<double>(angles.size());
    step += (num * sum_pr - sum_p * sum_r) / (num * sum_pp - sum_p * sum_p);
    result.closes = std::abs(step - whole) * num_photos < kHalf * std::abs(whole);
    if (result.closes) step = whole;
  }
  const std::vector<double> values = offsets(step);
  result.step_rad = step;
  result.offset_rad = NearestConstant(values);
  size_t near = 0;
  for (const double value : values)
    near += std::abs(WrapAngle(value - result.offset_rad)) < kHalf * std::abs(step) ? 1 : 0;
  if (2 * near <= angles.size()) return result;
  for (const AngleAtPlace& angle : angles)
    result.places.push_back({angle.image, static_cast<double>(angle.place)});
  return result;
}

StepsFinding StepsByMatches(const ScanFeatures& features, const std::vector<const Camera*>& cameras,
                            const std::vector<const View*>& views, const TurntableAxis& axis, double risk) {
  std::map<int, std::vector<AngleAtPlace>> angles_of;
  std::map<int, int> num_photos;
  double num_posed = 0;
  for (size_t i = 0; i < features.images.size(); ++i) {
    const int station = features.images[i].station;
    const int place = num_photos[station]++;
    if (views[i] == nullptr) continue;
    angles_of[station].push_back({static_cast<int>(i), place, views[i]->angle_deg * kDegree});
    num_posed += 1;
  }
  const std::vector<double> turns_deg = TurnsDeg();
  const double least = std::log(num_posed * static_cast<double>(turns_deg.size()) / risk);
  StepsFinding finding;
  std::vector<std::vector<double>> of_photos;
  for (const auto& [station, angles] : angles_of) {
    EqualStepsPrior steps = NearestEqualSteps(angles, num_photos[station]);
    if (steps.places.empty()) continue;
    std::vector<View> at_places;
    std::vector<const View*> of_image(views.size(), nullptr);
    std::vector<int> images;
    at_places.reserve(steps.places.size());
    for (const EqualStepsPrior::Place& place : steps.places) {
      const double angle = steps.offset_rad + steps.step_rad * place.steps;
      at_places.push_back(*views[static_cast<size_t>(place.image)]);
      at_places.back().angle_deg = WrapAngle(angle) / kDegree;
      at_places.back().world_from_object = TurnAbout(axis, angle);
      of_image[static_cast<size_t>(place.image)] = &at_places.back();
      images.push_back(place.image);
    }
    const TurnLikelihood likelihood(cameras, of_image, axis);
    const std::vector<std::vector<double>> of_station =
        TurnsOfPhotos(NearPairs(features, of_image, images, images, {}), likelihood, images, turns_deg);
    int num_elsewhere = 0;
    for (size_t k = 0; k < images.size(); ++k) {
      bool is_elsewhere = false;
      for (size_t t = 0; t < turns_deg.size(); ++t)
        is_elsewhere |= std::abs(turns_deg[t]) >= kLeastElsewhereDeg && of_station[k][t] > least;
      if (!is_elsewhere) continue;
      finding.elsewhere.push_back(images[k]);
      ++num_elsewhere;
    }
    if (LogPoissonTail(num_elsewhere, kAnywhere * static_cast<double>(images.size())) < std::log(risk))
      continue;
    of_photos.insert(of_photos.end(), of_station.begin(), of_station.end());
    finding.steps.push_back(std::move(steps));
  }
  if (of_photos.empty()) return finding;
  const double width_deg = ExpectedWidth(turns_deg, of_photos);
  for (EqualStepsPrior& steps : finding.steps) steps.sigma_rad = width_deg * kDegree;
  return finding;
}

}  // namespace s2gs
