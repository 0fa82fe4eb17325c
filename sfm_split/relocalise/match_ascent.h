#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/relocalise/ascent_pair.h"
#include "sfm_split/scene/focal_prior.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// The likelihood of a scan's matches by its stations' cameras, the angle at which each station begins and
/// the focal lengths, and the way to its top.
class MatchAscent {
 public:
  using State = AscentState;

  /// \param object_pairs  of PossibleObjectPairs(), also those between stations.
  MatchAscent(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
              const AlignedScene& aligned);

  /// Two or more stations whose photos share a camera: others have nothing to climb.
  bool HasStations() const { return are_shared_ && state_.stations.size() >= 2 && !pairs_.empty(); }
  bool HasBackground() const { return has_background_; }
  /// Place in State::stations of a station's number in the scene.
  int PlaceOf(int station) const { return place_of_station_.at(station); }

  /// Logarithm of the likelihood over that of chance.
  double Value(const AscentNoise& noise) const;
  /// To the top at one noise. Returns the value there. Throws Interrupted when the reporter asks to stop.
  double Climb(const AscentNoise& noise, int max_steps, Reporter& reporter);
  /// Of right matches where the cameras are; of the object's, inside stations: between them, what is wrong
  /// alike would widen it.
  AscentNoise NoiseBy(const AscentNoise& noise) const;
  /// Climbs and measures the noise in turn until it settles, which is returned.
  AscentNoise Settle(AscentNoise noise, Reporter& reporter);
  /// Turns of one station against the others at which, the rest held, the matches are likelier than at the
  /// turns beside, the likeliest first, without the present one; steps move the object's points by `step_px`
  /// [rad].
  std::vector<double> TurnsAlone(size_t station, double sigma_px, double step_px) const;

  /// Leaves pairs out, evenly of each two stations, until no more matches than these count.
  void Thin(size_t max_matches);
  /// Climbs leave these stations' turns as they are; without a background, which would say how their cameras
  /// stand, also how these are turned about the axis.
  void HoldTurns(std::vector<size_t> stations) { held_turns_ = std::move(stations); }
  /// Unknowns that matches can tell: all but what moves nothing against anything else.
  int NumTold() const;

  const State& state() const { return state_; }
  void SetState(State state) { state_ = std::move(state); }
  /// Writes the cameras, turns and focal lengths into the scene that this was made from.
  void Apply(AlignedScene* aligned) const;

 private:
  static constexpr int kOfStation =
      7;  // numbers of a camera's pose, and the angle that its station begins at
  static constexpr int kOfPair = 2 * kOfStation + 2;  // two stations and two focal lengths

  int NumUnknowns() const {
    return static_cast<int>(kAscentOfStation * state_.stations.size() + state_.log_focal.size());
  }
  std::array<int, kAscentOfPair> PlacesOf(const AscentPair& pair) const;
  void Linearize(const AscentNoise& noise, Eigen::MatrixXd* normal, Eigen::VectorXd* right) const;
  void Hold(Eigen::MatrixXd* normal, Eigen::VectorXd* right) const;
  State Moved(const Eigen::VectorXd& step) const;
  double RadiusPx() const;
  void AddPairs(const ScanFeatures& features, const AlignedScene& aligned,
                const std::vector<PossiblePair>& possible, bool is_object);

  TurntableAxis axis_;
  bool are_shared_ = true;  // each station's cameras
  bool has_background_ = false;
  State state_;
  std::vector<FocalPrior> priors_;
  std::vector<std::optional<size_t>> view_of_;  // per image
  std::map<int, int> place_of_station_;         // of a view
  std::map<uint32_t, int> place_of_camera_;
  std::vector<AscentPair> pairs_;
  std::vector<size_t> held_turns_;
};

}  // namespace s2gs
