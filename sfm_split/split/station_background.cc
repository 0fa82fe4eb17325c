#include "sfm_split/split/station_background.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <utility>

#include "sfm_split/split/pair_evidence.h"

namespace s2gs {
namespace {

using Descriptor = Eigen::Matrix<float, kDescriptorSize, 1>;

// Cosine of the largest angle between descriptors of one still point, as for still keypoints.
constexpr float kMinCosine = 0.88F;
constexpr float kDescriptorNorm = 512;  // COLMAP's, of 128 bytes
constexpr int kGuidedPasses = 2;        // of matches along the epipolar lines, and of fitting to them

Descriptor UnitDescriptor(const SplitImage& image, uint32_t keypoint) {
  const Eigen::Map<const Eigen::Matrix<uint8_t, kDescriptorSize, 1>> bytes(
      image.descriptors.data() + size_t{keypoint} * kDescriptorSize);
  const Descriptor descriptor = bytes.cast<float>();
  return descriptor / std::max(1.0F, descriptor.norm());
}

struct Feature {
  Eigen::Vector2f place_sum = Eigen::Vector2f::Zero();
  Descriptor descriptor_sum = Descriptor::Zero();
  float scale_sum = 0;
  int num_photos = 0;
  int last_photo = -1;

  Eigen::Vector2f Place() const { return place_sum / static_cast<float>(num_photos); }
};

// Features by the cells of a square grid that they lie in.
class FeatureMap {
 public:
  explicit FeatureMap(float radius) : radius_(radius) {}

  /// The feature near a place that looks most alike and that this photo has not shown yet; -1: none.
  int Find(const Eigen::Vector2f& xy, const Descriptor& descriptor, int photo) const {
    int best = -1;
    float best_cosine = kMinCosine;
    const Cell cell = CellOf(xy);
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const auto found = cells_.find({cell.first + dx, cell.second + dy});
        if (found == cells_.end()) continue;
        for (const int f : found->second) {
          const Feature& feature = features_[static_cast<size_t>(f)];
          if (feature.last_photo == photo || (feature.Place() - xy).norm() > radius_) continue;
          const float cosine = feature.descriptor_sum.dot(descriptor) / feature.descriptor_sum.norm();
          if (cosine <= best_cosine) continue;
          best_cosine = cosine;
          best = f;
        }
      }
    }
    return best;
  }

  /// Adds an observation to a feature, or to a new one for -1. Returns the feature. It stays in the cell of
  /// its first place, from which the mean does not move by more than a part of the radius.
  int Add(int f, const Eigen::Vector2f& xy, const Descriptor& descriptor, float scale, int photo) {
    if (f < 0) {
      f = static_cast<int>(features_.size());
      features_.emplace_back();
      cells_[CellOf(xy)].push_back(f);
    }
    Feature& feature = features_[static_cast<size_t>(f)];
    feature.place_sum += xy;
    feature.descriptor_sum += descriptor;
    feature.scale_sum += scale;
    ++feature.num_photos;
    feature.last_photo = photo;
    return f;
  }

  const std::vector<Feature>& features() const { return features_; }

 private:
  using Cell = std::pair<int, int>;
  // Wider than the radius by what a mean may have moved since its cell was chosen.
  Cell CellOf(const Eigen::Vector2f& xy) const {
    const Eigen::Vector2f cell = xy / (2 * radius_);
    return {static_cast<int>(std::floor(cell.x())), static_cast<int>(std::floor(cell.y()))};
  }

  float radius_;
  std::vector<Feature> features_;
  std::map<Cell, std::vector<int>> cells_;
};

// Whether a match follows a motion: near its line, and near its place where all lie on one plane.
class Follows {
 public:
  Follows(const TwoViewMotion& motion, double max_error_px) : motion_(motion), max_error_px_(max_error_px) {}
  bool operator()(const Eigen::Vector2f& xy1, const Eigen::Vector2f& xy2) const {
    if (SampsonErrorPx(motion_.F, xy1, xy2) > max_error_px_) return false;
    if (!motion_.is_planar) return true;
    const Eigen::Vector3d mapped = motion_.H * xy1.cast<double>().homogeneous();
    return (mapped.hnormalized() - xy2.cast<double>()).norm() <= 2 * max_error_px_;
  }

 private:
  const TwoViewMotion& motion_;
  double max_error_px_;
};

FeatureMatches MergedMatches(const FeatureMatches& a, const FeatureMatches& b) {
  FeatureMatches all = a;
  for (const FeatureMatch& match : b) {
    if (std::find(a.begin(), a.end(), match) == a.end()) all.push_back(match);
  }
  return all;
}

std::vector<int> AllOf(const FeatureMatches& matches) {
  std::vector<int> all(matches.size());
  std::iota(all.begin(), all.end(), 0);
  return all;
}

// The motion that the strict matches tell, and all of `loose` that follow it.
VerifiedPair VerifyGuided(const StationBackground& a, const StationBackground& b,
                          const FeatureMatches& strict, const FeatureMatches& loose,
                          const TwoViewMotionOptions& options) {
  VerifiedPair verified;
  verified.image1 = a.carrier;
  verified.image2 = b.carrier;
  TwoViewMotion motion = FitMotion(a.keypoints, b.keypoints, strict, AllOf(strict), options);
  if (motion.inliers.empty()) return verified;
  const double probability =
      EpipolarInlierProbability(a.keypoints, b.keypoints, strict, AllOf(strict), options.max_error_px);
  verified.log_false_alarms =
      LogFalseAlarms(static_cast<int>(motion.inliers.size()), static_cast<int>(strict.size()), probability);
  if (verified.log_false_alarms > kMaxLogFalseAlarms) return verified;
  const FeatureMatches candidates = MergedMatches(strict, loose);
  FeatureMatches matches;
  for (int pass = 0; pass < kGuidedPasses; ++pass) {
    FeatureMatches near;
    const Follows follows(motion, options.max_error_px);
    for (const FeatureMatch& match : candidates) {
      if (follows(a.keypoints[match.point2D_idx1], b.keypoints[match.point2D_idx2])) near.push_back(match);
    }
    TwoViewMotion refined = FitMotion(a.keypoints, b.keypoints, near, AllOf(near), options);
    if (refined.inliers.empty()) break;
    matches.clear();
    for (const int m : refined.inliers) matches.push_back(near[static_cast<size_t>(m)]);
    motion = std::move(refined);
  }
  verified.F = motion.F;
  verified.H = motion.H;
  verified.is_planar = motion.is_planar;
  verified.matches = std::move(matches);
  return verified;
}

// What somebody else matched between any photos of two stations: for each feature the one that most photos'
// matches name, where they name each other.
FeatureMatches GivenBetween(const StationBackground& a, const StationBackground& b,
                            const std::vector<int>& photos1, const std::vector<int>& photos2,
                            const GivenMatches& given) {
  std::map<std::pair<uint32_t, uint32_t>, int> votes;
  for (size_t p = 0; p < photos1.size(); ++p) {
    for (size_t q = 0; q < photos2.size(); ++q) {
      const auto i = static_cast<uint32_t>(photos1[p]);
      const auto j = static_cast<uint32_t>(photos2[q]);
      const auto found = given.find({std::min(i, j), std::max(i, j)});
      if (found == given.end()) continue;
      for (FeatureMatch match : found->second) {
        if (i > j) std::swap(match.point2D_idx1, match.point2D_idx2);
        const uint32_t f = a.feature_of_keypoint[p][match.point2D_idx1];
        const uint32_t g = b.feature_of_keypoint[q][match.point2D_idx2];
        if (f != StationBackground::kNoFeature && g != StationBackground::kNoFeature) ++votes[{f, g}];
      }
    }
  }
  std::map<uint32_t, std::pair<int, uint32_t>> best1;
  std::map<uint32_t, std::pair<int, uint32_t>> best2;
  for (const auto& [features, count] : votes) {
    const auto [f, g] = features;
    if (count > best1[f].first) best1[f] = {count, g};
    if (count > best2[g].first) best2[g] = {count, f};
  }
  FeatureMatches matches;
  for (const auto& [f, best] : best1) {
    if (best2.at(best.second).second == f) matches.push_back({f, best.second});
  }
  return matches;
}

}  // namespace

StationBackground MergeBackground(const std::vector<SplitImage>& images, const Stations& stations,
                                  const std::vector<std::vector<KeypointLabel>>& labels, int station,
                                  int carrier, int min_photos, double max_unmoved_px) {
  const std::vector<int>& photos = stations.images[static_cast<size_t>(station)];
  StationBackground merged;
  merged.carrier = carrier;
  FeatureMap map(static_cast<float>(max_unmoved_px));
  for (size_t p = 0; p < photos.size(); ++p) {
    const auto i = static_cast<size_t>(photos[p]);
    const SplitImage& image = images[i];
    std::vector<uint32_t>& feature_of = merged.feature_of_keypoint.emplace_back();
    feature_of.assign(image.keypoints.size(), StationBackground::kNoFeature);
    for (uint32_t k = 0; k < image.keypoints.size(); ++k) {
      if (labels[i][k] != KeypointLabel::kStatic) continue;
      const Eigen::Vector2f xy = stations.Move(photos[p], carrier, image.keypoints[k]);
      const Descriptor descriptor = UnitDescriptor(image, k);
      const float scale = image.scales.empty() ? 1 : image.scales[k];
      const int near = map.Find(xy, descriptor, static_cast<int>(p));
      feature_of[k] = static_cast<uint32_t>(map.Add(near, xy, descriptor, scale, static_cast<int>(p)));
    }
  }
  std::vector<uint32_t> place(map.features().size(), StationBackground::kNoFeature);
  for (size_t f = 0; f < place.size(); ++f) {
    const Feature& feature = map.features()[f];
    if (feature.num_photos < min_photos) continue;
    place[f] = static_cast<uint32_t>(merged.keypoints.size());
    merged.keypoints.push_back(feature.Place());
    merged.scales.push_back(feature.scale_sum / static_cast<float>(feature.num_photos));
    const Descriptor mean =
        feature.descriptor_sum * (kDescriptorNorm / std::max(1e-6F, feature.descriptor_sum.norm()));
    for (int d = 0; d < kDescriptorSize; ++d) {
      merged.descriptors.push_back(static_cast<uint8_t>(std::clamp(std::lround(mean(d)), 0L, 255L)));
    }
  }
  for (std::vector<uint32_t>& feature_of : merged.feature_of_keypoint) {
    for (uint32_t& f : feature_of) f = f == StationBackground::kNoFeature ? f : place[f];
  }
  return merged;
}

std::vector<BackgroundMatches> MatchBackgrounds(const std::vector<StationBackground>& backgrounds,
                                                const std::vector<ImagePair>& pairs,
                                                const GivenMatches& given, const Stations& stations,
                                                SplitMatching* matching) {
  PackedImages packed;
  packed.reserve(backgrounds.size());
  for (const StationBackground& background : backgrounds)
    packed.emplace_back(background.descriptors.data(), background.keypoints.size());
  std::vector<FeatureMatches> strict(pairs.size());
  std::vector<FeatureMatches> loose(pairs.size());
  if (given.empty()) {
    DescriptorMatchOptions mutual = matching->settings().match;
    mutual.max_ratio = 1;
    mutual.cross_check = true;
    DescriptorMatcher matcher(mutual);
    std::vector<DescriptorMatcher::Job> jobs;
    jobs.reserve(pairs.size());
    for (const ImagePair& pair : pairs) jobs.push_back({&packed[pair.first], &packed[pair.second]});
    if (matching->reporter().StopRequested()) throw Interrupted();
    matching->matcher()->MatchAll(jobs, &strict);
    if (matching->reporter().StopRequested()) throw Interrupted();
    matcher.MatchAll(jobs, &loose);
  } else {
    for (size_t p = 0; p < pairs.size(); ++p) {
      strict[p] = GivenBetween(backgrounds[pairs[p].first], backgrounds[pairs[p].second],
                               stations.images[pairs[p].first], stations.images[pairs[p].second], given);
    }
  }
  std::vector<BackgroundMatches> result(pairs.size());
  for (size_t p = 0; p < pairs.size(); ++p) {
    if (matching->reporter().StopRequested()) throw Interrupted();
    const StationBackground& a = backgrounds[pairs[p].first];
    const StationBackground& b = backgrounds[pairs[p].second];
    result[p].raw = {a.carrier, b.carrier, MergedMatches(strict[p], loose[p])};
    result[p].verified = VerifyGuided(a, b, strict[p], loose[p], matching->settings().motion);
    matching->reporter().Debug("background of stations " + std::to_string(pairs[p].first) + " and " +
                               std::to_string(pairs[p].second) + ": " + std::to_string(a.keypoints.size()) +
                               " and " + std::to_string(b.keypoints.size()) + " features, " +
                               std::to_string(strict[p].size()) + " matches, " +
                               std::to_string(loose[p].size()) + " nearest neighbours, " +
                               std::to_string(result[p].verified.matches.size()) + " follow one motion");
  }
  return result;
}

}  // namespace s2gs
