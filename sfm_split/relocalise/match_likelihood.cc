#include "sfm_split/relocalise/match_likelihood.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/turntable/wrong_matches.h"

namespace s2gs {
namespace {

constexpr double kRootTwoPi = 2.50662827463100050;
constexpr size_t kMaxMatches = 60;        // of a pair, evenly
constexpr double kUniformWidth = 3.4641;  // of a uniform distribution, over its standard deviation
constexpr double kFirstSigmaPx = 1;
constexpr double kLeastSigmaPx = 0.3;  // keypoints are no better
constexpr double kMostSigmaPx = 2;     // of keypoints that are found badly
constexpr int kRounds = 8;
constexpr int kShareRounds = 6;

struct Error {
  double px = 0;
  double chance = 0;  // density of a wrong match's error
};

// One round of expectation and maximisation over all pairs' errors.
MatchLikelihood Round(const std::vector<std::vector<Error>>& errors, double sigma_px) {
  MatchLikelihood result;
  double squares = 0;
  std::vector<double> over;  // density of a right match's error over that of a wrong one's
  const double peak = 1 / (sigma_px * kRootTwoPi);
  for (const std::vector<Error>& of_pair : errors) {
    over.clear();
    for (const Error& error : of_pair) {
      const double ratio = error.px / sigma_px;
      over.push_back(std::isfinite(error.px) ? peak / error.chance * std::exp(-0.5 * ratio * ratio) : 0);
    }
    double share = 0.5;
    for (int k = 0; k < kShareRounds; ++k) {
      double sum = 1;
      for (const double o : over) sum += share * o / (share * o + 1 - share);
      share = sum / (static_cast<double>(over.size()) + 2);
    }
    for (size_t m = 0; m < over.size(); ++m) {
      result.gain += std::log(1 - share + share * over[m]);
      const double right = share * over[m] / (share * over[m] + 1 - share);
      if (!(right > 0)) continue;
      result.inliers += right;
      squares += right * of_pair[m].px * of_pair[m].px;
    }
  }
  result.sigma_px = std::sqrt(squares / std::max(result.inliers, 1e-9));
  return result;
}

std::vector<PosedImage> PosedBy(const ScanFeatures& features, const AlignedScene& aligned) {
  std::map<std::string, const View*> view_of;
  for (const View& view : aligned.scene.views) view_of[view.name] = &view;
  std::map<uint32_t, const Camera*> camera_of;
  for (const Camera& camera : aligned.scene.cameras) camera_of[camera.camera_id] = &camera;
  std::vector<PosedImage> posed(features.images.size());
  for (size_t i = 0; i < posed.size(); ++i) {
    const auto view = view_of.find(features.images[i].name);
    if (view == view_of.end()) continue;
    const auto camera = camera_of.find(view->second->camera_id);
    if (camera == camera_of.end()) continue;
    posed[i] = {true, camera->second, view->second->CamFromObject()};
  }
  return posed;
}

struct PairOfPhotos {
  int image1 = 0;
  int image2 = 0;
  int steps = 0;  // between the photos, around their station's circle; 0: of two stations
  FeatureMatches matches;
};

}  // namespace

MatchLikelihood LikelihoodOfMatches(const ScanFeatures& features, const AlignedScene& aligned,
                                    bool within_stations) {
  const std::vector<PosedImage> posed = PosedBy(features, aligned);
  std::map<int, int> size_of_station;
  std::vector<int> place;
  for (const ScanImage& image : features.images) place.push_back(size_of_station[image.station]++);
  const auto displacement = [&](const PairOfPhotos& pair, const FeatureMatch& match) -> Eigen::Vector2d {
    return (features.images[static_cast<size_t>(pair.image2)].keypoints[match.point2D_idx2] -
            features.images[static_cast<size_t>(pair.image1)].keypoints[match.point2D_idx1])
        .cast<double>();
  };
  // The object's extent and how wrong matches move are those of all photos, placed or not: the same for every
  // scene.
  std::map<int, std::vector<PairOfPhotos>> pairs_of;  // by station; -1: of two stations
  double num = 0;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  Eigen::Vector2d squares = Eigen::Vector2d::Zero();
  for (const ImagePairMatches& given : AllPairs(features)) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    const int station = features.images[i].station;
    const bool same_station = station == features.images[j].station;
    if (within_stations && !same_station) continue;
    PairOfPhotos pair{given.image1, given.image2, 0, {}};
    if (same_station) {
      const int steps = std::abs(place[i] - place[j]);
      pair.steps = std::min(steps, size_of_station[station] - steps);
    }
    const FeatureMatches possible = PossibleObjectMatches(features, given);
    const size_t stride = 1 + possible.size() / (kMaxMatches + 1);
    for (size_t m = 0; m < possible.size(); m += stride) {
      pair.matches.push_back(possible[m]);
      for (const Eigen::Vector2f& xy : {features.images[i].keypoints[possible[m].point2D_idx1],
                                        features.images[j].keypoints[possible[m].point2D_idx2]}) {
        sum += xy.cast<double>();
        squares += xy.cast<double>().cwiseAbs2();
        num += 1;
      }
    }
    if (!pair.matches.empty()) pairs_of[same_station ? station : -1].push_back(std::move(pair));
  }
  if (num == 0) return {};
  const double extent =
      kUniformWidth * std::sqrt(std::max(1.0, (squares / num - (sum / num).cwiseAbs2()).mean()));
  std::vector<std::vector<Error>> errors;
  for (auto& [station, pairs] : pairs_of) {
    size_t total = 0;
    for (const PairOfPhotos& pair : pairs) total += pair.matches.size();
    std::stable_sort(pairs.begin(), pairs.end(),
                     [](const PairOfPhotos& a, const PairOfPhotos& b) { return a.steps > b.steps; });
    std::vector<Eigen::Vector2d> moves;
    for (const PairOfPhotos& pair : pairs) {
      if (station < 0 || static_cast<double>(moves.size()) > kFarShare * static_cast<double>(total)) break;
      for (const FeatureMatch& match : pair.matches) moves.push_back(displacement(pair, match));
    }
    const WrongMatches wrong(moves, extent);
    for (const PairOfPhotos& pair : pairs) {
      const auto i = static_cast<size_t>(pair.image1);
      const auto j = static_cast<size_t>(pair.image2);
      if (!posed[i].is_posed || !posed[j].is_posed) continue;
      errors.emplace_back();
      for (const FeatureMatch& match : pair.matches) {
        errors.back().push_back(
            {MatchErrorPx(posed[i], posed[j], features.images[i].keypoints[match.point2D_idx1].cast<double>(),
                          features.images[j].keypoints[match.point2D_idx2].cast<double>()),
             wrong.Chance(displacement(pair, match))});
      }
    }
  }
  double sigma_px = kFirstSigmaPx;
  MatchLikelihood result;
  for (int round = 0; round < kRounds; ++round) {
    result = Round(errors, sigma_px);
    const double next = std::clamp(result.sigma_px, kLeastSigmaPx, kMostSigmaPx);
    const bool is_settled = std::abs(next - sigma_px) <= 0.01 * sigma_px;
    sigma_px = next;
    if (is_settled) break;
  }
  result.sigma_px = sigma_px;
  return result;
}

std::vector<ImagePairMatches> AgreeingMatches(const ScanFeatures& features, const AlignedScene& aligned,
                                              double max_error_px) {
  const std::vector<PosedImage> posed = PosedBy(features, aligned);
  std::vector<ImagePairMatches> result;
  for (const ImagePairMatches& given : AllPairs(features)) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) continue;
    ImagePairMatches agreeing{given.image1, given.image2, {}};
    for (const FeatureMatch& match : PossibleObjectMatches(features, given)) {
      if (MatchErrorPx(posed[i], posed[j], features.images[i].keypoints[match.point2D_idx1].cast<double>(),
                       features.images[j].keypoints[match.point2D_idx2].cast<double>()) <= max_error_px) {
        agreeing.matches.push_back(match);
      }
    }
    if (!agreeing.matches.empty()) result.push_back(std::move(agreeing));
  }
  return result;
}

}  // namespace s2gs
