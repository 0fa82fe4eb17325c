#include "sfm_split/evidence/proven_pairs.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/circular_motion/wrong_matches.h"
#include "sfm_split/evidence/pair_proof.h"

namespace s2gs {
namespace {

constexpr double kFarApart = 3;  // neighbours are one or two steps apart, pairs across the end one to three
constexpr int kNextInOrder = 2;  // photos so far apart in order are neighbours
constexpr int kLeastOfTurn = 6;  // photos of a station that can be a turn
constexpr size_t kMaxProvenPairs = 60;  // of each kind: the time that their robust fits take

// Which pairs there are, what each proves, and how stations end.
class ProvenPairs {
 public:
  explicit ProvenPairs(const PosedMatches& matches) : matches_(matches) {
    const std::vector<ScanImage>& images = matches.features().images;
    for (size_t i = 0; i < images.size(); ++i) order_[images[i].station].push_back(static_cast<int>(i));
    for (const auto& entry : order_) endings_[entry.first] = EndingOf(entry.first);
  }

  void Record(ScanEvidence* evidence);
  const KeypointSet& of_others() const { return of_others_; }

 private:
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
  double TurnedDeg(const ImagePairMatches& pair) const;
  MatchMove MoveOfMatch(const ImagePairMatches& pair, const FeatureMatch& match) const;
  bool IsFar(const ImagePairMatches& pair) const;
  std::map<int, OrbitingThing> FindOrbits(const std::vector<const ImagePairMatches*>& seam) const;
  std::optional<ProvenPair> Prove(const ImagePairMatches& pair, const OrbitingThing& orbit, double risk,
                                  ScanEvidence* evidence);
  void RecordClosing(const std::vector<ProvenPair>& seam, ScanEvidence* evidence) const;
  void RecordDistant(const std::array<std::vector<ProvenPair>, 2>& proven, ScanEvidence* evidence) const;

  const PosedMatches& matches_;
  std::map<int, std::vector<int>> order_;  // images of a station, by name
  std::map<int, Ending> endings_;          // of the stations
  KeypointSet of_others_;                  // keypoints of bodies that the poses are not of
};

// Of photos of one station next to each other in order, and of its last ones with its first.
std::array<std::vector<const ImagePairMatches*>, 2> ProvenPairs::PairsInOrder() const {
  std::map<int, int> place;
  for (const auto& [station, images] : order_) {
    for (size_t k = 0; k < images.size(); ++k) place[images[k]] = static_cast<int>(k);
  }
  std::array<std::vector<const ImagePairMatches*>, 2> pairs;
  for (const ImagePairMatches& pair : matches_.features().raw_pairs) {
    if (!matches_.IsPosed(pair.image1) || !matches_.IsPosed(pair.image2)) continue;
    const int station = matches_.StationOf(pair.image1);
    if (station != matches_.StationOf(pair.image2)) continue;
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

// By the poses, from 0 to 180.
double ProvenPairs::TurnedDeg(const ImagePairMatches& pair) const {
  const double turned = matches_.views()[static_cast<size_t>(pair.image2)]->angle_deg -
                        matches_.views()[static_cast<size_t>(pair.image1)]->angle_deg;
  return std::abs(WrapAngle(turned * kDegree)) / kDegree;
}

MatchMove ProvenPairs::MoveOfMatch(const ImagePairMatches& pair, const FeatureMatch& match) const {
  return MoveOf(matches_.features(), pair.image1, pair.image2, match,
                TurnBetween(matches_.views()[static_cast<size_t>(pair.image1)]->angle_deg * kDegree,
                            matches_.views()[static_cast<size_t>(pair.image2)]->angle_deg * kDegree));
}

// By the poses, of photos of one station.
bool ProvenPairs::IsFar(const ImagePairMatches& pair) const {
  return TurnedDeg(pair) > kFarApart * endings_.at(matches_.StationOf(pair.image1)).step_deg;
}

// What orbits at each station that has photos far apart across the end, told by others that are far apart.
std::map<int, OrbitingThing> ProvenPairs::FindOrbits(const std::vector<const ImagePairMatches*>& seam) const {
  std::set<const ImagePairMatches*> asked;
  std::set<int> stations;
  for (const ImagePairMatches* pair : seam) {
    if (!IsFar(*pair)) continue;
    asked.insert(pair);
    stations.insert(matches_.StationOf(pair->image1));
  }
  std::map<int, std::vector<MatchMove>> moves;
  std::map<int, KeypointExtent> extents;
  for (const ImagePairMatches& pair : matches_.features().raw_pairs) {
    if (!matches_.IsPosed(pair.image1) || !matches_.IsPosed(pair.image2) || asked.count(&pair) > 0) continue;
    const int station = matches_.StationOf(pair.image1);
    if (station != matches_.StationOf(pair.image2) || stations.count(station) == 0 || !IsFar(pair)) continue;
    for (const FeatureMatch& match : PossibleObjectMatches(matches_.features(), pair)) {
      moves[station].push_back(MoveOfMatch(pair, match));
      extents[station].Add(matches_.KeypointsOf(pair.image1)[match.point2D_idx1].cast<double>());
    }
  }
  std::map<int, OrbitingThing> orbits;
  for (const auto& [station, of_station] : moves)
    orbits[station] = WrongMatches(of_station, extents[station].Px()).orbit();
  return orbits;
}

// What a pair proves, if anything, counts for its kind. Keypoints of other bodies are remembered. What goes
// with a thing that orbits tells nothing of how far it turned.
std::optional<ProvenPairs::ProvenPair> ProvenPairs::Prove(const ImagePairMatches& pair,
                                                          const OrbitingThing& orbit, double risk,
                                                          ScanEvidence* evidence) {
  FeatureMatches possible = PossibleObjectMatches(matches_.features(), pair);
  possible.erase(
      std::remove_if(possible.begin(), possible.end(),
                     [&](const FeatureMatch& match) { return orbit.Explains(MoveOfMatch(pair, match)); }),
      possible.end());
  const MatchError posed = [&](const Eigen::Vector2d& xy1, const Eigen::Vector2d& xy2) {
    return MatchErrorPx(matches_.posed()[static_cast<size_t>(pair.image1)],
                        matches_.posed()[static_cast<size_t>(pair.image2)], xy1, xy2);
  };
  const PairProof proof = ProvePair(matches_.KeypointsOf(pair.image1), matches_.KeypointsOf(pair.image2),
                                    possible, posed, matches_.bound_px(), risk);
  for (const int m : proof.others) {
    const FeatureMatch& match = possible[static_cast<size_t>(m)];
    of_others_.insert({pair.image1, match.point2D_idx1});
    of_others_.insert({pair.image2, match.point2D_idx2});
  }
  if (!proof.is_proven) return std::nullopt;
  evidence->other_bodies += proof.has_other_body ? 1 : 0;
  FeatureMatches proven;
  for (const int m : proof.proven) proven.push_back(possible[static_cast<size_t>(m)]);
  return ProvenPair{matches_.StationOf(pair.image1), TurnedDeg(pair), proof.is_contradicted,
                    matches_.Compare(pair, proven, matches_.bound_px())};
}

void ProvenPairs::Record(ScanEvidence* evidence) {
  const std::array<std::vector<const ImagePairMatches*>, 2> pairs = PairsInOrder();
  std::array<std::vector<ProvenPair>, 2> proven;
  const auto num_pairs = static_cast<double>(pairs[kNeighbours].size() + pairs[kSeam].size());
  std::map<int, OrbitingThing> orbits = FindOrbits(pairs[kSeam]);
  for (const Kind kind : {kNeighbours, kSeam}) {
    const size_t stride = (pairs[kind].size() + kMaxProvenPairs - 1) / kMaxProvenPairs;
    int& contradicted =
        kind == kNeighbours ? evidence->contradicted_neighbours : evidence->contradicted_seams;
    for (size_t p = 0; p < pairs[kind].size(); p += stride) {
      const ImagePairMatches& given = *pairs[kind][p];
      // Of photos that are near nearly all details turn with the table.
      const bool is_asked = kind == kSeam && IsFar(given);
      const OrbitingThing orbit = is_asked ? orbits[matches_.StationOf(given.image1)] : OrbitingThing();
      const std::optional<ProvenPair> pair = Prove(given, orbit, kScanRisk / num_pairs, evidence);
      if (!pair) continue;
      proven[kind].push_back(*pair);
      contradicted += pair->is_contradicted ? 1 : 0;
    }
  }
  evidence->neighbour_pairs = static_cast<int>(proven[kNeighbours].size());
  evidence->seam_pairs = static_cast<int>(proven[kSeam].size());
  RecordClosing(proven[kSeam], evidence);
  RecordDistant(proven, evidence);
}

// Photos that the poses leave far apart may have been neighbours where they share as many details; what they
// share of fewer is what things that look alike do, and says nothing of poses.
void ProvenPairs::RecordDistant(const std::array<std::vector<ProvenPair>, 2>& proven,
                                ScanEvidence* evidence) const {
  std::vector<double> angles;
  for (const ProvenPair& pair : proven[kNeighbours]) {
    angles.push_back(pair.apart_deg);
    evidence->neighbours.Add(pair.matches);
  }
  if (!angles.empty()) evidence->neighbour_apart_deg = UpperMedian(angles);
  const double far_deg = kFarApart * evidence->neighbour_apart_deg.value_or(360);
  const double mean = static_cast<double>(evidence->neighbours.all) / std::max(1, evidence->neighbour_pairs);
  for (const Kind kind : {kNeighbours, kSeam}) {
    for (const ProvenPair& pair : proven[kind]) {
      const bool is_far = pair.apart_deg > far_deg;
      const bool shares_much = 2 * static_cast<double>(pair.matches.all) >= mean;
      if (kind == kSeam && (!is_far || shares_much)) evidence->seam.Add(pair.matches);
      if (!is_far || !shares_much || !pair.is_contradicted) continue;
      ++evidence->far_pairs;
      evidence->widest_far_pair_deg = std::max(evidence->widest_far_pair_deg.value_or(0), pair.apart_deg);
    }
  }
}

// Which of the pairs of last photos and first ones are neighbours across the end of a turn.
void ProvenPairs::RecordClosing(const std::vector<ProvenPair>& seam, ScanEvidence* evidence) const {
  std::set<int> closed;
  std::set<int> came_back;
  for (const ProvenPair& pair : seam) {
    const Ending& ending = endings_.at(pair.station);
    if (ending.end == End::kCameBack && !pair.is_contradicted) came_back.insert(pair.station);
    if (ending.end != End::kClosed || pair.apart_deg > kFarApart * ending.step_deg) continue;
    evidence->closing.Add(pair.matches);
    if (!pair.is_contradicted) closed.insert(pair.station);
  }
  evidence->closed_stations = static_cast<int>(closed.size());
  evidence->round_stations = static_cast<int>(std::count_if(
      endings_.begin(), endings_.end(), [](const auto& entry) { return entry.second.end == End::kClosed; }));
  evidence->turns_of_nothing = static_cast<int>(came_back.size());
}

// A station's steps in order, and the one from its last photo to its first, make a turn when they go round
// and each is about as wide as the others, the one across the end too; none when they add up to nothing.
// Neither where more than a tenth of them are wider than a quarter turn: names that do not follow the table
// add up to any number.
ProvenPairs::Ending ProvenPairs::EndingOf(int station) const {
  std::vector<double> steps;
  const View* first = nullptr;
  const View* before = nullptr;
  const auto add_step = [&](const View& from, const View& to) {
    steps.push_back(WrapAngle((to.angle_deg - from.angle_deg) * kDegree));
  };
  for (const int image : order_.at(station)) {
    const View* view = matches_.views()[static_cast<size_t>(image)];
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

}  // namespace

KeypointSet RecordProvenPairs(const PosedMatches& matches, ScanEvidence* evidence) {
  ProvenPairs pairs(matches);
  pairs.Record(evidence);
  return pairs.of_others();
}

}  // namespace s2gs
