#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "s2gs/core/gaussians.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/core/rotating_region.h"
#include "s2gs/image/image_file.h"
#include "s2gs/kernel/selection.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/rigid3.h"

namespace s2gs {

enum class BackendKind { kCpu, kCuda };
const char* BackendName(BackendKind kind);

/// Which bodies the scene has, and thereby what p may be.
enum class SceneBodies {
  kBoth,        ///< every Gaussian learns its p.
  kObjectOnly,  ///< 2DGS with masks: p is 1 for all.
  kStaticOnly,  ///< 2DGS without masks: p is 0 for all.
};

struct RenderRequest {
  PinholeView view;
  SceneBodies bodies = SceneBodies::kBoth;
  bool freeze_foreground = false;  ///< p is settled, as in TrainStep.
  DrawnBody drawn = DrawnBody::kAll;
  std::optional<RotatingRegion> without_static;       ///< static Gaussians in it are not drawn,
  std::optional<RotatingSide> side;                   ///< but for those of this, which count as rotating.
  std::array<float, 3> background_color = {0, 0, 0};  ///< [0, 1]
  bool geometry = false;                              ///< depth, normal and distortion maps.
  bool foreground = false;                            ///< the map of p.
  bool hard_foreground = false;                       ///< of the indicator p >= tau instead.
  /// Empty, or asked by several threads while the CPU makes room for a view, draws and copies it, where a
  /// large photo takes a minute: once it is true, Render() throws Interrupted.
  std::function<bool()> stop_requested;
};

/// Maps of height * width pixels, rows from top to bottom; empty when not asked for.
struct RenderedView {
  int width = 0;
  int height = 0;
  std::vector<float> color;           ///< 3 per pixel, interleaved R G B; not clamped.
  std::vector<float> alpha;           ///< 1 - transmittance, before the background colour.
  std::vector<float> expected_depth;  ///< sum of w z over sum of w, z along the camera's axis; 0 where empty.
  std::vector<float> median_depth;    ///< z where the transmittance falls through 1/2; 0 where it does not.
  std::vector<float> normal;          ///< 3 per pixel, camera frame, sum of w n, facing the camera.
  std::vector<float> distortion;      ///< the depth distortion of 2DGS.
  std::vector<float> foreground;      ///< sum of w p.
};

/// One training photo in memory, undistorted.
struct TrainingPhoto {
  PinholeView view;           ///< of the size of `image`.
  Image8 image;               ///< RGB.
  std::vector<uint8_t> mask;  ///< empty, or height * width values: 255 rotating part, 0 not.
};

/// Learning rates of one iteration, of Adam (beta .9, .999). TrainOptions says what they are in training.
struct LearningRates {
  float centre = 0;  ///< scene units.
  float log_scale = 0;
  float rotation = 0;
  float opacity = 0;
  float sh_dc = 0;
  float sh_rest = 0;
  float foreground = 0;
};

/// Weights of one iteration's loss, the paper's (13); a term of weight 0 is not computed. Terms of the image
/// are means over all pixels (and channels), those of the model over all Gaussians (and neighbours).
/// TrainOptions says what they are in training.
struct LossWeights {
  float dssim = 0;              ///< share of D-SSIM, 1 - SSIM; the rest is L1.
  float normal = 0;             ///< alpha - (rendered normal) . (normal of the expected depth's map).
  float distortion = 0;         ///< the distortion map.
  float local_consistency = 0;  ///< (10): KL of a Gaussian's p from each neighbour's; not once p is frozen.
  float entropy_3d = 0;         ///< (11); not once p is frozen.
  float entropy_2d = 0;         ///< (12)
  float mask = 0;  ///< binary cross entropy of the p map against the photo's mask, where there is one.
};

/// One iteration.
struct TrainStep {
  int64_t iteration = 0;  ///< from 1; Adam's bias correction and the random streams follow from it.
  int photo = 0;          ///< index into SetPhotos' list.
  SceneBodies bodies = SceneBodies::kBoth;
  std::array<float, 3> background_color = {0, 0, 0};
  /// Pixels outside the photo's mask are replaced by the background colour (2DGS with masks).
  bool cut_out_mask = false;
  bool freeze_foreground = false;  ///< p is settled: 0 or 1, not learnt, and its soft path left out.
  /// Only tiles that Gaussians of the rotating part reach are drawn; elsewhere the photo counts as met.
  /// Gaussians that reach none of these tiles stay as they are, with their moments. With settled p alone.
  bool only_rotating_tiles = false;
  int sh_degree = 0;
  LearningRates rates;
  LossWeights weights;
  bool collect_statistics = false;  ///< for densification.
};

/// Means of the loss terms over the steps since they were last taken, unweighted.
struct LossTerms {
  int64_t steps = 0;
  double total = 0;  ///< weighted.
  double l1 = 0, dssim = 0, normal = 0, distortion = 0;
  double local_consistency = 0, entropy_3d = 0, entropy_2d = 0, mask = 0;
};

/// Adaptive density control, as in 2DGS.
struct DensifyStep {
  int64_t iteration = 0;
  uint64_t random_seed = 0;
  float min_gradient = 2e-4F;  ///< mean gradient of the loss by the centre on screen, in 2DGS's units (NDC).
  float max_clone_scale = 0;   ///< Gaussians of larger scale are split, others cloned [scene units].
  float max_scale = 0;         ///< Gaussians of larger scale are removed; 0: none [scene units].
  float min_opacity = 0.05F;   ///< below which Gaussians are removed.
  /// No more than these afterwards; 0: no bound. Room is given to the largest gradients first (of equal ones
  /// to the first Gaussian); those left over are decided again as if `grow` were false.
  int64_t max_count = 0;
  bool grow = true;  ///< false: only removes.
};

struct DensifyResult {
  int64_t cloned = 0, split = 0, removed = 0;
  int64_t count = 0;       ///< afterwards.
  int64_t not_finite = 0;  ///< removed besides, because a parameter was NaN, infinite or out of range.
};

/// Everything that training needs to go on exactly where it stopped.
struct TrainState {
  Gaussians gaussians;
  Gaussians first_moment;            ///< Adam's m, same layout.
  Gaussians second_moment;           ///< Adam's v.
  std::vector<float> gradient_sum;   ///< per Gaussian, since the last densification.
  std::vector<float> view_count;     ///< how many views added to it.
  std::vector<uint32_t> neighbours;  ///< k per Gaussian; empty when not in use.
  int num_neighbours = 0;
};

/// The Gaussians of the given indices, with everything that the optimiser keeps of them. Neighbours are
/// forgotten.
TrainState SelectState(const TrainState& state, const std::vector<uint32_t>& indices);

/// Where the Gaussians are and to which body they belong.
struct Placement {
  std::vector<float> centre;            ///< 3 per Gaussian.
  std::vector<float> foreground_logit;  ///< 1

  size_t size() const { return foreground_logit.size(); }
};

/// What one body alone looks like in a view.
struct BodySight {
  std::vector<uint8_t> is_seen;  ///< by Gaussian.
  std::vector<float> alpha;      ///< by pixel.
};

struct BackendInfo {
  BackendKind kind = BackendKind::kCpu;
  std::string device;        ///< e.g. the GPU's name, or "2 threads, AVX2".
  int64_t memory_bytes = 0;  ///< in use by the model, its optimiser and buffers.
  int64_t peak_memory_bytes = 0;
  int64_t free_device_bytes = 0;  ///< that the GPU still has; 0 for the CPU.
};

/// The request's choice as the kernels need it.
DrawnSelection<float> SelectionOf(const RenderRequest& request);

/// Where the kernels run. A backend owns iteration over splats and pixels, tiles, sorting, memory and
/// reduction; the mathematics is kernel/'s, the same for all. Calls come from one thread. Errors of the
/// device and lack of memory throw UserError.
class Backend {
 public:
  Backend() = default;
  Backend(const Backend&) = delete;
  Backend& operator=(const Backend&) = delete;
  virtual ~Backend() = default;

  virtual BackendInfo Info() const = 0;

  /// Replaces the training photos. Called again when training goes to another resolution.
  virtual void SetPhotos(std::vector<TrainingPhoto> photos) = 0;
  /// Replaces the model and the optimiser's state. Empty moments mean zeros.
  virtual void SetState(const TrainState& state) = 0;
  virtual TrainState GetState() const = 0;
  virtual Gaussians GetGaussians() const = 0;
  virtual int64_t Count() const = 0;
  virtual Placement GetPlacement() const;

  /// Keeps the Gaussians of these indices alone, in this order, with everything that the optimiser has of
  /// them. Neighbours are forgotten.
  virtual void Keep(const std::vector<uint32_t>& indices);
  /// Replaces all foreground logits. Those that change lose their moments.
  virtual void SetForegroundLogits(const std::vector<float>& logits);

  /// Draws a view; does not touch the training state.
  virtual RenderedView Render(const RenderRequest& request) = 0;

  /// Forward, loss, backward and Adam. May return before the work is done.
  virtual void Step(const TrainStep& step) = 0;
  /// Returns when the work of all steps is done.
  virtual void Wait() const {}
  /// The loss since the last call. Waits for the steps. A step that the device could not finish for lack of
  /// buffer space is not counted (see backend_cuda.cu), so `steps` may fall short by a few.
  virtual LossTerms TakeLoss() = 0;

  /// Applies kernel/densify.h's decisions. The survivors keep their order and moments, a split one's place is
  /// taken by its first child; added Gaussians follow in their parents' order, without moments. The sums for
  /// the gradient start anew, and neighbours in use are found anew.
  virtual DensifyResult Densify(const DensifyStep& step) = 0;
  /// Clamps opacities to at most `max_opacity` and forgets their moments.
  virtual void ResetOpacity(float max_opacity) = 0;
  /// The largest share w = alpha * transmittance that each Gaussian has in any pixel of these views, to find
  /// those that no photo shows. p counts as settled. Empty: this backend cannot tell.
  /// \param drawn  the others are not there, and get 0.
  virtual std::vector<float> PeakWeights(const std::vector<PinholeView>& /*views*/, SceneBodies /*bodies*/,
                                         DrawnBody /*drawn*/) {
    return {};
  }
  /// Which Gaussians of a body have a share w of at least `min_weight` in some pixel of the view when the
  /// others are not there, and how much that body covers of each pixel. p counts as settled. Empty: this
  /// backend cannot tell.
  virtual BodySight SeeBody(const PinholeView& /*view*/, DrawnBody /*drawn*/, float /*min_weight*/) {
    return {};
  }
  /// Finds the k nearest neighbours of each centre, for (10).
  virtual void RefreshNeighbours(int k) = 0;
};

/// \param num_threads  0: all cores. Results do not depend on it.
std::unique_ptr<Backend> MakeCpuBackend(int num_threads = 0);
/// Throws UserError when this build has no CUDA backend, or there is no usable GPU.
std::unique_ptr<Backend> MakeCudaBackend(int gpu_index = 0);

}  // namespace s2gs
