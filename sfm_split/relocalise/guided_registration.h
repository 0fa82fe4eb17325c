#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

// Photos that SfM left out, though their camera is known (from their station, or from the background's
// reconstruction), lack one number: the table's angle. Matches of two photos with a ratio test miss most of
// what a weakly textured or newly seen side shows. Here every keypoint proposes the few points of the object
// that look most like it, right or wrong, and the angle is swept: at the right one far more of the proposals
// fall on their keypoints than chance gives at the others.

struct GuidedOptions {
  int max_looks = 6;              ///< keypoints of a point whose descriptors stand for it.
  int num_candidates = 3;         ///< points that a keypoint proposes.
  double max_distance_rad = 0.6;  ///< between the descriptors.
  /// Between the directions that a point is seen from here and where its descriptor was taken.
  double max_view_change_deg = 50;
  double max_error_px = 3;  ///< of a proposal, in the sweep; the camera is not known better.
  double window_px = 8;   ///< around a point's place at the angle found, in which its keypoint is looked for.
  int min_inliers = 10;   ///< proposals that must agree on the angle.
  double min_margin = 2;  ///< how many times those at any other angle.
  double max_chance = 1e-4;  ///< expected number of angles at which as many agree by chance.

  OptionCheck Check() const;
};

/// The object's points and what they look like.
class ObjectAppearance {
 public:
  struct Look {
    int point = 0;
    int image = 0;  ///< of the features, that the descriptor is from.
    uint32_t keypoint = 0;
    Eigen::Vector3f seen_from = Eigen::Vector3f::Zero();  ///< unit vector from the point to the camera.
  };

  /// \param descriptor  128 bytes.
  void Add(const Look& look, const uint8_t* descriptor);
  int AddPoint(const Eigen::Vector3d& x_in_object);

  const std::vector<Eigen::Vector3d>& points() const { return points_; }
  const std::vector<Look>& looks() const { return looks_; }
  const uint8_t* Descriptor(size_t look) const { return descriptors_.data() + look * 128; }

 private:
  std::vector<Eigen::Vector3d> points_;  // in the object's frame
  std::vector<Look> looks_;
  std::vector<uint8_t> descriptors_;  // 128 a look
};

/// A photo that is to be placed.
struct UnplacedPhoto {
  const Camera* camera = nullptr;
  Rigid3 cam_from_world;
  const std::vector<Eigen::Vector2f>* keypoints = nullptr;  ///< [px]
  std::vector<uint8_t> descriptors;                         ///< 128 a keypoint.
  std::vector<bool> usable;                                 ///< per keypoint: may be the object's.
};

struct GuidedPlacement {
  bool found = false;
  double angle_rad = 0;  ///< the object's frame is the world's at 0.
  int inliers = 0;       ///< points and keypoints that agree in the sweep.
  /// The most at any angle that is 5 degrees or more away; on the flanks of the same peak, without what
  /// agrees at its top.
  int other = 0;
  double chance = 1;  ///< expected number of angles with as many by chance.
  struct Match {
    uint32_t keypoint = 0;
    size_t look = 0;
  };
  std::vector<Match> matches;  ///< one-to-one, at the angle found; empty unless found.
};

/// The table's angle in one photo.
GuidedPlacement PlaceByAppearance(const ObjectAppearance& looks, const UnplacedPhoto& photo,
                                  const TurntableAxis& axis, const GuidedOptions& options);

/// A photo that was placed, for the report.
struct GuidedPhoto {
  std::string name;
  int inliers = 0;
  int other = 0;
  double chance = 1;
  int matches = 0;
};

/// num_keypoints x 128 bytes of an image of the features.
using ReadDescriptors = std::function<std::vector<uint8_t>(int image)>;

/// Places the photos that a refined scene lacks and whose camera is known; each that was placed adds to what
/// the object looks like, until no more can be. Views are added to the scene and its background model, their
/// matches with the keypoints of the object's points to `pairs`; points are left to another RefineScan.
/// Throws Interrupted when the reporter asks to stop.
std::vector<GuidedPhoto> RegisterByAppearance(const ScanFeatures& features,
                                              const ReadDescriptors& read_descriptors,
                                              const GuidedOptions& options, Reporter& reporter,
                                              AlignedScene* aligned, std::vector<ImagePairMatches>* pairs);

}  // namespace s2gs
