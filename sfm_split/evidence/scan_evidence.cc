#include "sfm_split/evidence/scan_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/circular_motion/turn_reach.h"
#include "sfm_split/evidence/chance.h"
#include "sfm_split/evidence/match_noise.h"
#include "sfm_split/evidence/pair_proof.h"
#include "sfm_split/evidence/step_evidence.h"
#include "sfm_split/scene/focal_prior.h"

namespace s2gs {
namespace {

constexpr double kFarApart = 3;   // neighbours are one or two steps apart, pairs across the end one to three
constexpr int kLeastUnmoved = 3;  // photos of one camera place: two may be taken from one hand
constexpr int kNextInOrder = 2;   // photos so far apart in order are neighbours
constexpr int kLeastOfTurn = 6;   // photos of a station that can be a turn
constexpr size_t kMaxProvenPairs = 60;  // of each kind: the time that their robust fits take
constexpr double kNoiseRange = 6;       // of the bound, over which errors are looked at
constexpr int kLeastSupport = 15;       // COLMAP's least motion between two photos
constexpr double kRisk = 1.0 / 400;     // that chance alone places one of a scan's photos
constexpr double kFarMoving = 0.8;      // of matches move less: those at the axis hardly move

class Gatherer {
 public:
  Gatherer(const ScanFeatures& features, const TurntableScene& scene, double bound_px)
      : features_(features),
        bound_px_(bound_px),
        axis_(scene.axis),
        posed_(features.images.size()),
        view_of_(features.images.size()) {
    std::map<uint32_t, const Camera*> cameras;
    for (const Camera& camera : scene.cameras) cameras[camera.camera_id] = &camera;
    std::map<std::string, const View*> views;
    for (const View& view : scene.views) views[view.name] = &view;
    for (size_t i = 0; i < features.images.size(); ++i) {
      order_[features.images[i].station].push_back(static_cast<int>(i));
      const auto found = views.find(features.images[i].name);
      if (found == views.end()) continue;
      view_of_[i] = found->second;
      posed_[i] = {true, cameras.at(found->second->camera_id), found->second->CamFromObject()};
    }
    errors_.emplace(posed_, AllKeypoints());
  }

  void VerifiedMatches(const HeldBackKeypoints& held_back, ScanEvidence* evidence);
  void SupportOfPhotos(bool has_one_angle_each, ScanEvidence* evidence) const;
  void ProvenPairs(ScanEvidence* evidence);
  void Angles(const std::vector<bool>& is_in_steps, ScanEvidence* evidence) const;
  void Steps(ScanEvidence* evidence);

 private:
  const Keypoints& KeypointsOf(int image) const {
    return features_.images[static_cast<size_t>(image)].keypoints;
  }
  int StationOf(int image) const { return features_.images[static_cast<size_t>(image)].station; }
  bool IsPosed(int image) const { return posed_[static_cast<size_t>(image)].is_posed; }
  std::vector<const Keypoints*> AllKeypoints() const {
    std::vector<const Keypoints*> all;
    all.reserve(features_.images.size());
    for (const ScanImage& image : features_.images) all.push_back(&image.keypoints);
    return all;
  }
  // Against the same matches with their second keypoints exchanged among them.
  AgreeingMatches Compare(const ImagePairMatches& pair, const FeatureMatches& matches) const {
    AgreeingMatches result;
    result.all = static_cast<int64_t>(matches.size());
    const auto num_within = [&](const FeatureMatches& of) {
      const std::vector<double> errors = errors_->Of(pair.image1, pair.image2, of);
      return std::count_if(errors.begin(), errors.end(), [&](double error) { return error <= bound_px_; });
    };
    result.agreeing = num_within(matches);
    const size_t away = matches.size() / 2;
    if (away == 0) return result;
    FeatureMatches exchanged = matches;
    for (size_t m = 0; m < matches.size(); ++m)
      exchanged[m].point2D_idx2 = matches[(m + away) % matches.size()].point2D_idx2;
    result.by_chance = static_cast<double>(num_within(exchanged));
    return result;
  }
  enum Kind { kNeighbours, kSeam };
  struct ProvenPair {
    int station = 0;
    double apart_deg = 0;  // of the table, between its photos
    bool is_contradicted = false;
    AgreeingMatches matches;
  };
  // How a station's photos end, by the poses.
  enum class End {
    kOpen,      // far from where they began, or nobody knows: an arc, or names that do not follow the table
    kClosed,    // next to where they began, after going round without a gap
    kCameBack,  // next to where they began, by the way that they went
  };
  struct Ending {
    End end = End::kOpen;
    double step_deg = 0;  // between photos that follow each other (median)
  };
  Ending EndingOf(int station) const;
  std::array<std::vector<const ImagePairMatches*>, 2> PairsInOrder() const;
  std::optional<ProvenPair> Prove(const ImagePairMatches& pair, double risk, ScanEvidence* evidence);
  void RecordClosing(const std::vector<ProvenPair>& seam, ScanEvidence* evidence) const;

  const ScanFeatures& features_;
  double bound_px_;
  TurntableAxis axis_;
  std::vector<PosedImage> posed_;
  std::optional<MatchErrors> errors_;  // against these
  std::vector<const View*> view_of_;
  std::vector<int> verified_;                     // matches of each photo that agree with its pose
  std::map<int, std::vector<int>> order_;         // images of a station, by name
  std::set<std::pair<int, uint32_t>> of_others_;  // keypoints of bodies that the poses are not of
};

// Sets of keypoints that matches tie together.
class TiedKeypoints {
 public:
  void Tie(const ImagePairMatches& pair, const FeatureMatch& match) {
    ties_.emplace_back(PlaceOf(pair.image1, match.point2D_idx1), PlaceOf(pair.image2, match.point2D_idx2));
  }

  int NumSets() const {
    UnionFind sets(place_.size());
    auto num = static_cast<int>(place_.size());
    for (const auto& [a, b] : ties_) num -= sets.Join(a, b) ? 1 : 0;
    return num;
  }

 private:
  uint32_t PlaceOf(int image, uint32_t keypoint) {
    return place_.try_emplace({image, keypoint}, static_cast<uint32_t>(place_.size())).first->second;
  }

  std::map<std::pair<int, uint32_t>, uint32_t> place_;
  std::vector<std::pair<uint32_t, uint32_t>> ties_;
};

// How much larger errors are than others of which as many are right: by what half of the right ones stay
// within. A fit of noise beside wrong ones has two answers where many slide along by a few pixels, and one of
// the two may be given the other.
double NoiseRatio(std::vector<double> errors, std::vector<double> others, double right_share) {
  const double share = std::clamp(right_share, 0.0, 1.0) / 2;
  return Quantile(std::move(errors), share) / std::max(Quantile(std::move(others), share), 1e-9);
}

void Gatherer::VerifiedMatches(const HeldBackKeypoints& held_back, ScanEvidence* evidence) {
  struct OfPair {
    AgreeingMatches compared;
    AgreeingMatches held_back;
    std::vector<double> errors;
    std::vector<char> is_held;
  };
  const std::vector<ImagePairMatches>& pairs = features_.object_pairs;
  std::vector<OfPair> of_pairs(pairs.size());
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
    const ImagePairMatches& pair = pairs[static_cast<size_t>(p)];
    OfPair& of_pair = of_pairs[static_cast<size_t>(p)];
    if (!IsPosed(pair.image1) || !IsPosed(pair.image2)) return;
    of_pair.compared = Compare(pair, pair.matches);
    FeatureMatches held;
    of_pair.errors = errors_->Of(pair.image1, pair.image2, pair.matches);
    for (const FeatureMatch& match : pair.matches) {
      const bool is_held = held_back[static_cast<size_t>(pair.image1)][match.point2D_idx1] ||
                           held_back[static_cast<size_t>(pair.image2)][match.point2D_idx2];
      of_pair.is_held.push_back(is_held ? 1 : 0);
      if (is_held) held.push_back(match);
    }
    of_pair.held_back = Compare(pair, held);
  });
  std::vector<double> held_errors;
  std::vector<double> adjusted_errors;
  TiedKeypoints held;
  verified_.assign(posed_.size(), 0);
  for (size_t p = 0; p < pairs.size(); ++p) {
    const ImagePairMatches& pair = pairs[p];
    const OfPair& of_pair = of_pairs[p];
    evidence->verified.Add(of_pair.compared);
    if (StationOf(pair.image1) != StationOf(pair.image2)) evidence->across_stations.Add(of_pair.compared);
    evidence->held_back.Add(of_pair.held_back);
    for (size_t m = 0; m < of_pair.errors.size(); ++m) {
      const double error = of_pair.errors[m];
      (of_pair.is_held[m] != 0 ? held_errors : adjusted_errors).push_back(error);
      if (of_pair.is_held[m] != 0) held.Tie(pair, pair.matches[m]);
      if (error > bound_px_) continue;
      ++verified_[static_cast<size_t>(pair.image1)];
      ++verified_[static_cast<size_t>(pair.image2)];
    }
  }
  if (static_cast<int>(adjusted_errors.size()) >= kLeastSupport) {
    evidence->adjusted_noise_px = FitNoise(adjusted_errors, kNoiseRange * bound_px_).sigma;
  }
  if (evidence->adjusted_noise_px && static_cast<int>(held_errors.size()) >= kLeastSupport) {
    const double right = evidence->verified.Share().value_or(1);
    evidence->held_back_noise_px =
        *evidence->adjusted_noise_px * NoiseRatio(std::move(held_errors), std::move(adjusted_errors), right);
  }
  evidence->held_back_sets = held.NumSets();
}

// A photo whose place on the turntable is one angle is told by fewer matches than a motion between two
// photos: all its matches, right and wrong ones, must agree with its angle as they would not with the best of
// the angles that they can tell apart.
void Gatherer::SupportOfPhotos(bool has_one_angle_each, ScanEvidence* evidence) const {
  std::vector<size_t> weak;
  for (size_t i = 0; i < posed_.size(); ++i) {
    if (posed_[i].is_posed && verified_[i] < kLeastSupport) weak.push_back(i);
  }
  std::vector<AgreeingMatches> of_photo(posed_.size());
  AgreeingMatches sum;
  if (has_one_angle_each && !weak.empty()) {
    for (const ImagePairMatches& pair : AllPairs(features_)) {
      if (!IsPosed(pair.image1) || !IsPosed(pair.image2)) continue;
      const AgreeingMatches compared = Compare(pair, PossibleObjectMatches(features_, pair));
      sum.Add(compared);
      of_photo[static_cast<size_t>(pair.image1)].Add(compared);
      of_photo[static_cast<size_t>(pair.image2)].Add(compared);
    }
  }
  const double by_chance = static_cast<double>(sum.by_chance + 1) / static_cast<double>(sum.all + 1);
  for (const size_t i : weak) {
    // Points half a photo from the axis move by the bound, to both sides, from one such angle to the next.
    const double angles = kPi * static_cast<double>(posed_[i].camera->width) / (2 * bound_px_);
    const double risk = kRisk / static_cast<double>(posed_.size());
    const AgreeingMatches& own = of_photo[i];
    const bool is_told =
        has_one_angle_each && own.agreeing >= LeastAgreeingMatches(own.all, by_chance, angles, risk);
    if (!is_told) evidence->unsupported.push_back(features_.images[i].name);
  }
}

// Of photos of one station next to each other in order, and of its last ones with its first.
std::array<std::vector<const ImagePairMatches*>, 2> Gatherer::PairsInOrder() const {
  std::map<int, int> place;
  for (const auto& [station, images] : order_) {
    for (size_t k = 0; k < images.size(); ++k) place[images[k]] = static_cast<int>(k);
  }
  std::array<std::vector<const ImagePairMatches*>, 2> pairs;
  for (const ImagePairMatches& pair : features_.raw_pairs) {
    if (!IsPosed(pair.image1) || !IsPosed(pair.image2)) continue;
    const int station = StationOf(pair.image1);
    if (station != StationOf(pair.image2)) continue;
    const int apart = std::abs(place[pair.image1] - place[pair.image2]);
    const int count = static_cast<int>(order_.at(station).size());
    if (apart <= kNextInOrder) {
      pairs[kNeighbours].push_back(&pair);
    } else if (count >= kLeastOfTurn && count - apart <= kNextInOrder) {
      pairs[kSeam].push_back(&pair);
    }
  }
  return pairs;
}

// What a pair proves, if anything, counts for its kind. Keypoints of other bodies are remembered.
std::optional<Gatherer::ProvenPair> Gatherer::Prove(const ImagePairMatches& pair, double risk,
                                                    ScanEvidence* evidence) {
  const FeatureMatches possible = PossibleObjectMatches(features_, pair);
  const MatchError posed = [&](const Eigen::Vector2d& xy1, const Eigen::Vector2d& xy2) {
    return MatchErrorPx(posed_[static_cast<size_t>(pair.image1)], posed_[static_cast<size_t>(pair.image2)],
                        xy1, xy2);
  };
  const PairProof proof =
      ProvePair(KeypointsOf(pair.image1), KeypointsOf(pair.image2), possible, posed, bound_px_, risk);
  for (const int m : proof.others) {
    const FeatureMatch& match = possible[static_cast<size_t>(m)];
    of_others_.insert({pair.image1, match.point2D_idx1});
    of_others_.insert({pair.image2, match.point2D_idx2});
  }
  if (!proof.is_proven) return std::nullopt;
  evidence->other_bodies += proof.has_other_body ? 1 : 0;
  FeatureMatches proven;
  for (const int m : proof.proven) proven.push_back(possible[static_cast<size_t>(m)]);
  const double turned = view_of_[static_cast<size_t>(pair.image2)]->angle_deg -
                        view_of_[static_cast<size_t>(pair.image1)]->angle_deg;
  return ProvenPair{StationOf(pair.image1), std::abs(WrapAngle(turned * kDegree)) / kDegree,
                    proof.is_contradicted, Compare(pair, proven)};
}

void Gatherer::ProvenPairs(ScanEvidence* evidence) {
  const std::array<std::vector<const ImagePairMatches*>, 2> pairs = PairsInOrder();
  std::array<std::vector<ProvenPair>, 2> proven;
  const auto num_pairs = static_cast<double>(pairs[kNeighbours].size() + pairs[kSeam].size());
  for (const Kind kind : {kNeighbours, kSeam}) {
    const size_t stride = (pairs[kind].size() + kMaxProvenPairs - 1) / kMaxProvenPairs;
    AgreeingMatches& sum = kind == kNeighbours ? evidence->neighbours : evidence->seam;
    int& contradicted =
        kind == kNeighbours ? evidence->contradicted_neighbours : evidence->contradicted_seams;
    for (size_t p = 0; p < pairs[kind].size(); p += stride) {
      const std::optional<ProvenPair> pair = Prove(*pairs[kind][p], kRisk / num_pairs, evidence);
      if (!pair) continue;
      proven[kind].push_back(*pair);
      sum.Add(pair->matches);
      contradicted += pair->is_contradicted ? 1 : 0;
    }
  }
  evidence->neighbour_pairs = static_cast<int>(proven[kNeighbours].size());
  evidence->seam_pairs = static_cast<int>(proven[kSeam].size());
  RecordClosing(proven[kSeam], evidence);
  if (proven[kNeighbours].empty()) return;
  std::vector<double> angles;
  for (const ProvenPair& pair : proven[kNeighbours]) angles.push_back(pair.apart_deg);
  const double median = UpperMedian(angles);
  evidence->neighbour_apart_deg = median;
  const double mean = static_cast<double>(evidence->neighbours.all) / evidence->neighbour_pairs;
  for (const auto& kind : proven) {
    for (const ProvenPair& pair : kind) {
      if (!pair.is_contradicted || pair.apart_deg <= kFarApart * median ||
          2 * static_cast<double>(pair.matches.all) < mean)
        continue;
      ++evidence->far_pairs;
      evidence->widest_far_pair_deg = std::max(evidence->widest_far_pair_deg.value_or(0), pair.apart_deg);
    }
  }
}

// Which of the pairs of last photos and first ones are neighbours across the end of a turn.
void Gatherer::RecordClosing(const std::vector<ProvenPair>& seam, ScanEvidence* evidence) const {
  std::set<int> closed;
  std::set<int> came_back;
  for (const ProvenPair& pair : seam) {
    const Ending ending = EndingOf(pair.station);
    if (ending.end == End::kCameBack && !pair.is_contradicted) came_back.insert(pair.station);
    if (ending.end != End::kClosed || pair.apart_deg > kFarApart * ending.step_deg) continue;
    evidence->closing.Add(pair.matches);
    if (!pair.is_contradicted) closed.insert(pair.station);
  }
  evidence->closed_stations = static_cast<int>(closed.size());
  evidence->turns_of_nothing = static_cast<int>(came_back.size());
}

// What the matches of photos near each other say of each angle.
void Gatherer::Angles(const std::vector<bool>& is_in_steps, ScanEvidence* evidence) const {
  std::vector<const Camera*> cameras;
  for (const PosedImage& image : posed_) cameras.push_back(image.camera);
  const StepEvidence steps =
      AskSteps(features_, cameras, view_of_, axis_, of_others_, is_in_steps, evidence->overdispersion, kRisk);
  const auto name = [&](int image) { return features_.images[static_cast<size_t>(image)].name; };
  for (const MisturnedPhoto& photo : steps.misturned) {
    evidence->misturned.push_back(name(photo.image));
    evidence->worst_misturn_deg = std::max(evidence->worst_misturn_deg, std::abs(photo.off_deg));
  }
  for (const int image : steps.untold) evidence->untold.push_back(name(image));
  for (const int image : steps.untold_stations) evidence->untold_stations.push_back(name(image));
}

// A station's steps in order, and the one from its last photo to its first, make a turn when they go round
// and each is about as wide as the others, the one across the end too; none when they add up to nothing.
// Neither where more than a tenth of them are wider than a quarter turn: names that do not follow the table
// add up to any number.
Gatherer::Ending Gatherer::EndingOf(int station) const {
  std::vector<double> steps;
  const View* first = nullptr;
  const View* before = nullptr;
  const auto add_step = [&](const View& from, const View& to) {
    steps.push_back(WrapAngle((to.angle_deg - from.angle_deg) * kDegree));
  };
  for (const int image : order_.at(station)) {
    const View* view = view_of_[static_cast<size_t>(image)];
    if (view == nullptr) continue;
    if (before != nullptr) add_step(*before, *view);
    if (first == nullptr) first = view;
    before = view;
  }
  Ending ending;
  if (first == nullptr) return ending;
  add_step(*before, *first);
  const double sum = std::accumulate(steps.begin(), steps.end(), 0.0);
  for (double& step : steps) step = std::abs(step);
  const double last = steps.back();
  const double widest = *std::max_element(steps.begin(), steps.end());
  const double median = UpperMedian(steps);
  ending.step_deg = median / kDegree;
  const auto wide =
      std::count_if(steps.begin(), steps.end(), [](double step) { return step > 90 * kDegree; });
  if (10 * static_cast<size_t>(wide) > steps.size() || last > kFarApart * median) return ending;
  if (std::lround(sum / (360 * kDegree)) == 0) {
    ending.end = End::kCameBack;
  } else if (widest <= kFarApart * median) {
    ending.end = End::kClosed;
  }
  return ending;
}

// A point that turns by an angle moves no farther than its distance from the axis times the angle; what the
// object sweeps over a station's photos is at least that wide. Photos that share details are compared, in
// whatever order they were taken and named.
void Gatherer::Steps(ScanEvidence* evidence) {
  std::map<int, std::vector<const ImagePairMatches*>> pairs_of;
  std::map<int, std::vector<float>> x_of;
  std::map<int, std::vector<float>> y_of;
  for (const ImagePairMatches& pair : features_.object_pairs) {
    const int station = StationOf(pair.image1);
    for (const FeatureMatch& match : pair.matches) {
      x_of[station].push_back(KeypointsOf(pair.image1)[match.point2D_idx1].x());
      y_of[station].push_back(KeypointsOf(pair.image1)[match.point2D_idx1].y());
    }
    if (station != StationOf(pair.image2) || !IsPosed(pair.image1) || !IsPosed(pair.image2)) continue;
    if (pair.matches.size() >= static_cast<size_t>(kLeastSupport)) pairs_of[station].push_back(&pair);
  }
  const auto upper = [](std::vector<double> values) {
    const auto at =
        values.begin() + static_cast<std::ptrdiff_t>(kFarMoving * static_cast<double>(values.size()));
    std::nth_element(values.begin(), at, values.end());
    return *at;
  };
  std::vector<double> steps;
  std::vector<double> least;
  for (const auto& [station, pairs] : pairs_of) {
    const double swept = SweptPx(x_of[station], y_of[station]);
    if (!(swept > 0)) continue;
    for (const ImagePairMatches* pair : pairs) {
      const View& one = *view_of_[static_cast<size_t>(pair->image1)];
      const View& two = *view_of_[static_cast<size_t>(pair->image2)];
      steps.push_back(std::abs(WrapAngle((two.angle_deg - one.angle_deg) * kDegree)) / kDegree);
      std::vector<double> moved;
      for (const FeatureMatch& match : pair->matches) {
        moved.push_back(
            (KeypointsOf(pair->image1)[match.point2D_idx1] - KeypointsOf(pair->image2)[match.point2D_idx2])
                .norm());
      }
      least.push_back(upper(moved) / (kMagnification * swept) / kDegree);
    }
  }
  if (!steps.empty()) evidence->median_step_deg = UpperMedian(steps);
  if (!least.empty()) evidence->least_step_deg = UpperMedian(least);
}

// Of each image of the features: its angle is tied to others by a prior.
std::vector<bool> InSteps(const ScanFeatures& features, const TurntableScene& scene,
                          const JointReport& joint) {
  std::set<std::string> tied;
  for (size_t v = 0; v < scene.views.size() && v < joint.angle_prior_share.size(); ++v) {
    if (joint.angle_prior_share[v] > 0) tied.insert(scene.views[v].name);
  }
  std::vector<bool> result;
  result.reserve(features.images.size());
  for (const ScanImage& image : features.images) result.push_back(tied.count(image.name) > 0);
  return result;
}

// Where the axis lies between the cameras and the object's points.
void RecordAxis(const AlignedScene& aligned, ScanEvidence* evidence) {
  const TurntableAxis& axis = aligned.scene.axis;
  const auto radial = [&](const Eigen::Vector3d& x) -> Eigen::Vector3d {
    const Eigen::Vector3d from_axis = x - axis.point;
    return from_axis - axis.direction * axis.direction.dot(from_axis);
  };
  std::vector<double> radii;
  std::vector<double> heights;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& [id, point] : aligned.object.points3D) {
    const Eigen::Vector3d r = radial(point.xyz);
    radii.push_back(r.norm());
    heights.push_back(axis.direction.dot(point.xyz));
    mean += r / std::max(r.norm(), 1e-300);
  }
  if (static_cast<int>(radii.size()) < kLeastSupport) return;
  const double radius = UpperMedian(radii);
  const double height = UpperMedian(heights);
  std::vector<double> camera_radii;
  std::vector<double> camera_heights;
  for (const View& view : aligned.scene.views) {
    const Eigen::Vector3d centre = CameraCentre(view.cam_from_world);
    camera_radii.push_back(radial(centre).norm());
    camera_heights.push_back(std::abs(axis.direction.dot(centre) - height));
  }
  if (!(radius > 0) || camera_radii.empty()) return;
  evidence->camera_radius_rel = UpperMedian(camera_radii) / radius;
  evidence->points_one_side = mean.norm() / static_cast<double>(radii.size());
  evidence->camera_height_rel = UpperMedian(camera_heights) / radius;
}

void RecordCameras(const ScanFeatures& features, const std::vector<Camera>& cameras, ScanEvidence* evidence) {
  evidence->photos = static_cast<int>(features.images.size());
  std::map<int, int> photos_of_station;
  for (const ScanImage& image : features.images) ++photos_of_station[image.station];
  for (const auto& [station, count] : photos_of_station) {
    evidence->unmoved_photos += count >= kLeastUnmoved ? count : 0;
  }
  for (const Camera& camera : cameras) {
    evidence->focal_widths.push_back(FocalLengths(camera).x() / static_cast<double>(camera.width));
    const auto expected = features.cameras.find(camera.camera_id);
    evidence->are_photos_cut |=
        expected != features.cameras.end() &&
        PrincipalPointShift(camera, PrincipalPoint(expected->second)).norm() > kMostLensShift;
  }
}

}  // namespace

ScanEvidence GatherEvidence(const ScanFeatures& features, const AlignedScene& aligned,
                            const JointReport& joint, const HeldBackKeypoints& held_back,
                            const MatchFindings& findings, double max_error_px) {
  const TurntableScene& scene = aligned.scene;
  ScanEvidence evidence;
  evidence.bound_px = max_error_px;
  if (findings.noise_px > 0) evidence.match_noise_px = findings.noise_px;
  evidence.overdispersion = findings.overdispersion;
  evidence.placed = static_cast<int>(scene.views.size());
  evidence.is_object_free = joint.model == JointModel::kFreeObject;
  RecordCameras(features, scene.cameras, &evidence);
  std::set<std::string> placed;
  std::set<int> stations;
  for (const View& view : scene.views) {
    placed.insert(view.name);
    stations.insert(view.station);
  }
  evidence.stations = static_cast<int>(stations.size());
  for (const ScanImage& image : features.images) {
    if (placed.count(image.name) == 0) evidence.missing.push_back(image.name);
  }
  Gatherer gatherer(features, scene, max_error_px);
  gatherer.VerifiedMatches(held_back, &evidence);
  const bool has_one_angle_each = joint.model == JointModel::kSharedStations;
  gatherer.SupportOfPhotos(has_one_angle_each, &evidence);
  gatherer.ProvenPairs(&evidence);
  gatherer.Angles(InSteps(features, scene, joint), &evidence);
  gatherer.Steps(&evidence);
  RecordAxis(aligned, &evidence);

  if (!joint.observability.computed) return evidence;
  std::vector<double> sigmas;
  for (size_t v = 0; v < joint.angle_sigma_deg.size(); ++v) {
    double sigma = joint.angle_sigma_deg[v];
    // Where no background ties a station to the reference's, the angle between them is anybody's choice, and
    // how surely the object tells its poses is what counts: by its points, and where photos share a camera,
    // by all matches of their station.
    if (std::isinf(sigma) && aligned.background.images.empty() && v < scene.views.size()) {
      const double of_points = v < joint.turn_sigma_deg.size() ? joint.turn_sigma_deg[v] : 0;
      const auto found = findings.turn_sigma_deg.find(scene.views[v].station);
      if (found != findings.turn_sigma_deg.end()) {
        sigma = std::max(found->second, of_points);
      } else if (evidence.is_object_free && of_points > 0) {
        sigma = of_points;
      }
    }
    if (sigma > 0) sigmas.push_back(sigma);
  }
  if (!sigmas.empty()) {
    evidence.angle_sigma_median_deg = UpperMedian(sigmas);
    evidence.angle_sigma_max_deg = *std::max_element(sigmas.begin(), sigmas.end());
  }
  evidence.angle_prior_share = AnglePriorShare(joint);
  for (const double share : joint.focal_prior_share)
    evidence.focal_prior_share = std::max(evidence.focal_prior_share.value_or(0), share);
  for (size_t c = 0; c < joint.focal_sigma_px.size() && c < scene.cameras.size(); ++c) {
    const double relative = joint.focal_sigma_px[c] / FocalLengths(scene.cameras[c]).x();
    if (relative > 0) evidence.focal_sigma_rel = std::max(evidence.focal_sigma_rel.value_or(0), relative);
    const auto prior = features.has_prior_focal.find(scene.cameras[c].camera_id);
    evidence.is_focal_guessed |= relative == 0 && prior != features.has_prior_focal.end() && !prior->second;
  }
  if (joint.axis_direction_sigma_deg >= 0) evidence.axis_sigma_deg = joint.axis_direction_sigma_deg;
  if (joint.scale_sigma_rel >= 0) evidence.scale_sigma_rel = joint.scale_sigma_rel;
  return evidence;
}

ScanEvidence GatherOneBodyEvidence(const ScanFeatures& features, const std::vector<Camera>& cameras,
                                   int placed) {
  ScanEvidence evidence;
  evidence.is_one_body = true;
  evidence.placed = placed;
  RecordCameras(features, cameras, &evidence);
  return evidence;
}

}  // namespace s2gs
