#pragma once

#include <ceres/loss_function.h>

#include <Eigen/Core>
#include <array>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/prior_term.h"
#include "sfm_split/joint_system/reprojection_cost.h"

namespace s2gs {

/// Where the loss turns from squared, for keypoints of a standard deviation.
double LossScalePx(double sigma_px);

/// The standard deviation of a keypoint's coordinate that a loss' scale stands for.
double SigmaOfLossPx(double loss_scale_px);

/// Null for squared errors. The options' scale is above 0.
std::unique_ptr<ceres::LossFunction> MakeLoss(const JointOptions& options);

/// The joint adjustment's parameter blocks and residuals, for Ceres and for the linearised system alike.
class JointSystem {
 public:
  struct Block {
    double* values = nullptr;
    int size = 0;
    std::vector<int> free;  ///< indices of the values that are not held.
    std::string name;       ///< e.g. "station 2"
    bool used = false;      ///< by at least one active observation.
  };
  struct Term {
    ReprojectionCost cost;
    std::array<double*, 5> values{};  ///< parameter blocks in the cost's order; the last is the point.
    std::array<int, 4> blocks{};      ///< indices into blocks() of all but the point.
    int num_blocks = 0;               ///< without the point.
    double weight = 1;
    int image = 0;
    int point = 0;  ///< among the body's.
    bool of_object = false;
  };

  JointSystem(const JointProblem& problem, const JointOptions& options, bool fix_gauge);
  JointSystem(const JointSystem&) = delete;
  JointSystem& operator=(const JointSystem&) = delete;

  const std::vector<Block>& blocks() const { return blocks_; }
  const std::vector<Term>& terms() const { return terms_; }
  /// Those that the active observations leave something to say.
  const std::vector<PriorTerm>& priors() const { return priors_; }
  int PoseBlock(int pose) const { return pose; }
  int IntrinsicsBlock(int camera) const { return num_poses_ + camera; }
  int AxisBlock() const { return num_poses_ + num_cameras_; }
  int AngleBlock(int image) const { return num_poses_ + num_cameras_ + 1 + image; }
  int ObjectPoseBlock(int image) const { return num_poses_ + num_cameras_ + image; }
  /// Which priors are of each kind of the wobble prior's deviations.
  struct WobbleTerms {
    std::vector<size_t> tilts;
    std::vector<size_t> shifts;
    std::vector<size_t> harmonic_tilts;
    std::vector<size_t> harmonic_shifts;
  };
  const WobbleTerms& wobble_terms() const { return wobble_terms_; }
  int NumFree() const;
  Eigen::Vector3d CentreOfPose(int pose) const;
  int anchor() const { return anchor_; }
  /// Whether background points tie a pose's place about the axis to the anchor's.
  bool IsTied(int pose) const { return ties_[pose] == ties_[anchor_]; }

  void WriteBack(JointProblem* problem) const;

 private:
  void AddBlocks(const JointProblem& problem, const JointOptions& options);
  void AddTerms(const JointProblem& problem, const JointBody& body, bool of_object);
  void AddPriors(const JointProblem& problem, const JointOptions& options);
  void AddStationTurn(const StationTurnPrior& turn, double scale_px);
  void AddTurns(const JointProblem& problem, double scale_px);
  void AddRims(const JointProblem& problem, double scale_px);
  void AddWobble(const JointProblem& problem, double scale_px);
  // The block of an image's smooth wobble; -1: its pose lies about a pure turn.
  std::vector<int> AddHarmonics(const JointProblem& problem, double scale_px);
  // The parts of a prior that say by how much an image's object turns about the axis.
  void AddTurnOf(int image, double factor, PriorTerm* term) const;
  void TieByBackground(const JointProblem& problem);
  void FixGauge(const JointProblem& problem);
  void Hold(int block, int value);
  void HoldAll(int block) { blocks_[block].free.clear(); }

  int num_poses_ = 0;
  int num_cameras_ = 0;
  int anchor_ = 0;
  std::vector<int> ties_;  // per pose: equal where background points tie them to each other
  bool free_object_ = false;
  Eigen::Vector3d axis_direction_;                   // that there is
  std::vector<std::array<double, 6>> poses_;         // (w, C)
  std::vector<Eigen::Matrix3d> pose_rotations_;      // R0
  std::vector<std::array<double, 6>> object_poses_;  // (w, t)
  std::vector<Eigen::Matrix3d> object_rotations_;
  std::vector<std::vector<double>> intrinsics_;
  std::array<double, 4> axis_{};
  std::vector<double> angles_;
  std::vector<Eigen::Vector3d> object_points_;
  std::vector<Eigen::Vector3d> background_points_;
  std::vector<Block> blocks_;
  std::vector<Term> terms_;
  std::vector<std::array<double, 2>> equal_steps_;  // (offset, step)
  std::vector<WobbleHarmonics> harmonics_;
  WobbleTerms wobble_terms_;                        // places in priors_
  std::vector<std::array<double, 2>> rim_circles_;  // (height, radius)
  std::vector<PriorTerm> priors_;
};

}  // namespace s2gs
