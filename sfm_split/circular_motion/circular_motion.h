#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/focal_prior.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

// The table as one camera sees it, from matches that may be wrong and without any reconstruction.
//
// Where the camera stands still the world is the camera, and between two photos with table angles t1, t2
// every point of the object moves as
//     x2 = R(n, t2 - t1) (x1 - p) + p
// in the camera's frame, with the axis' unit direction n and its foot p, whose distance is the unit of
// length. Each match that is right has an epipolar error e = N(0, sigma); each that is wrong has one spread
// over the object's extent. The likelihood of all matches of a station's photos is that mixture, with a share
// of right ones for each pair. Unknown are n and p (three numbers), one angle a photo, and for each camera,
// over all stations that it took, the focal length and one number of radial distortion, both with priors.
//
// Two photos hardly see how far the table turned between them: with equal steps the likelihood changes by one
// or two within half a degree, while focal length, elevation and step trade off. What tells the step is a
// turn that closes, and points that three photos in a row show: where the outer two see one, the middle one
// has it at a place along its move. So both hypotheses start the search: equal steps that close after the
// station's photos, and equal steps of any size. All pairs count for both, those across the seam among them,
// so that the two are compared by one likelihood of the same matches. Steps are equal unless the Bayesian
// information criterion has the angles free. (Fitzgibbon, Cross, Zisserman, "Automatic 3D model construction
// for turn-table sequences", 1998, for the geometry.)

/// Matches of two photos of one station; most may be wrong.
struct CircularPair {
  int photo1 = 0;  ///< place in the station's order of capture.
  int photo2 = 0;
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> matches;  ///< [px]
};

/// Points that three photos in a row of one station show; likewise.
struct CircularRow {
  std::array<int, 3> photos{};                          ///< places.
  std::vector<std::array<Eigen::Vector2d, 3>> triples;  ///< [px]
};

struct CircularStation {
  int camera = 0;  ///< index into the cameras.
  int num_photos = 0;
  std::vector<CircularPair> pairs;
  std::vector<CircularRow> rows;
};

class CircularSearch;

struct CircularOptions {
  double noise_px = 1;   ///< largest standard deviation of a match's epipolar error.
  int max_matches = 60;  ///< of a pair.
  int num_refined = 4;  ///< starts of each view that are refined where turns close; else one a view and step.
  int min_photos = 4;   ///< stations with fewer are not fitted.
  uint32_t random_seed = 0;
  /// A search with these options that has begun, which is awaited where it is of the same features; nullptr:
  /// none.
  const CircularSearch* begun = nullptr;

  OptionCheck Check() const;
};

struct CircularStationFit {
  bool found = false;
  Eigen::Vector3d axis = Eigen::Vector3d::UnitY();  ///< n in the camera's frame, up.
  Eigen::Vector3d foot = Eigen::Vector3d::UnitZ();  ///< p, of unit length, at right angles to n.
  std::vector<double> angles_rad;                   ///< per photo; 0 at the first.
  std::vector<char> placed;                         ///< per photo: 1 where matches tell its angle.
  bool closes = false;                              ///< the steps in order of capture make one whole turn.
  double gain = 0;  ///< logarithm of the likelihood over that of chance alone.
  int matches = 0;
  int inliers = 0;  ///< matches that are rather right than wrong.
};

struct CircularMotion {
  std::vector<Camera> cameras;           ///< with focal length and distortion as fitted.
  std::vector<double> focal_sigma_log;   ///< per camera, of the logarithm of its focal length.
  std::vector<char> distortion_is_free;  ///< per camera: its distortion is fitted, as the data ask for it.
  std::vector<CircularStationFit> stations;
  bool steps_are_equal = false;     ///< in each station: the matches do not ask for others.
  double sigma_px = 0;              ///< of a right match's epipolar error.
  double log_posterior = 0;         ///< of all stations: gains and priors.
  double open_log_posterior = 0;    ///< the best without stations that start as closed turns.
  double closed_log_posterior = 0;  ///< the best with all stations starting as closed turns.
  /// The next one of those two and of stations that are closed or open as is likelier of each, where matches
  /// do not tell which is right: it is nearly as likely, and puts photos elsewhere. Without rivals of its
  /// own.
  std::vector<CircularMotion> rivals;
};

/// Cameras of fisheye models are not fitted: their stations are not found.
/// \param priors  one per camera.
/// Throws Interrupted when the reporter asks to stop.
CircularMotion FitCircularMotion(const std::vector<CircularStation>& stations,
                                 const std::vector<Camera>& cameras, const std::vector<FocalPrior>& priors,
                                 const CircularOptions& options, Reporter& reporter);

}  // namespace s2gs
