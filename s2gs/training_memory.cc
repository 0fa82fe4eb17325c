#include "s2gs/training_memory.h"

#include <algorithm>
#include <limits>
#include <string>

#include "s2gs/core/gaussians.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr int64_t kModel = 4 * kFloatsPerGaussian;
// Parameters, both moments, and the sums of gradients and views.
constexpr int64_t kState = 3 * kModel + 2 * 4;
constexpr int64_t kNeighbours = 5 * 4;  // of the options' default number
// Pairs of a splat and a tile of 16 px: 1.3 to 3 a Gaussian in trained scenes of 640 to 1600 px.
constexpr int64_t kPairs = 3;

// The CPU's: a splat's row; per pair its entry in the tile's list and its gradient; where growth builds the
// new model, or a checkpoint is written, a second state stands beside the first.
constexpr int64_t kCpuPerGaussian = 2 * kState + kNeighbours + 120 + kPairs * (8 + 68);
constexpr int64_t kCpuPerPixel = 4 * 52;  // maps, their gradients, scratch of SSIM

// CUDA's: planes are 1.5 times as long as the model had Gaussians when they were made longer; a second model
// beside the first where it grows; a packed splat and its gradient, the planes of the colours' derivatives
// and of the last steps' gradients by them, keys and numbers of both sorts with their scratch; a pair's
// places in the lists of hits of its tile's eight warps.
constexpr int64_t kCudaPerGaussian = 2 * 3 * kModel + kNeighbours + (64 + 4 + 4 + 8 + 4) +
                                     (64 + 4 + 4 + 33 * 4 + 1 + 8 + 4 + 4 + 1) + 60 + kPairs * (24 + 8 * 8);
constexpr int64_t kCudaPerPixel = 4 * 33;
// On the host beside CUDA: a checkpoint, or the model that is written.
constexpr int64_t kHostPerGaussian = 2 * kState;
constexpr int64_t kHostPerPixel = 4 * 20;  // maps of a view that was drawn

constexpr int64_t kProgram = 70'000'000;  // with its libraries and the sparse models

// turn_evidence.h looks at photos of this many pixels at most: a picture, what is outside the photo, covered,
// seen.
constexpr int64_t kEvidencePixels = 400 * 400;
constexpr int64_t kEvidencePerPixel = 3 + 1 + 1 + 1 + 4;

std::string InMegabytes(int64_t bytes) {
  const int64_t megabytes = (bytes + 999'999) / 1'000'000;
  return std::to_string(megabytes) + " MB";
}

// The most Gaussians that leave room; negative when not even the photos have it.
int64_t MostGaussians(const MemoryNeed& need, int64_t limit) {
  if (need.fixed_bytes > limit) return -1;
  return need.bytes_per_gaussian > 0 ? (limit - need.fixed_bytes) / need.bytes_per_gaussian
                                     : std::numeric_limits<int64_t>::max();
}

// The longest side at which so many Gaussians fit, to whole tens of pixels; 0: none.
int FittingSide(const TrainingSize& size, BackendKind kind, const MemoryLimits& limits,
                int64_t num_gaussians) {
  for (int side = size.longest_side_px / 10 * 10; side >= 10; side -= 10) {
    const double share = static_cast<double>(side) / size.longest_side_px;
    const auto reduced = [&](int64_t bytes) {
      return static_cast<int64_t>(share * share * static_cast<double>(bytes));
    };
    TrainingSize smaller = size;
    smaller.photo_bytes = reduced(size.photo_bytes);
    smaller.trained_bytes = reduced(size.trained_bytes);
    smaller.largest_view_px = reduced(size.largest_view_px);
    const TrainingMemory memory = PredictTrainingMemory(smaller, kind);
    if (memory.host.At(num_gaussians) <= limits.host && memory.device.At(num_gaussians) <= limits.device)
      return side;
  }
  return 0;
}

}  // namespace

TrainingMemory PredictTrainingMemory(const TrainingSize& size, BackendKind kind) {
  TrainingMemory memory;
  // The scene's photos, and those that training has at its present size.
  memory.host.fixed_bytes = size.photo_bytes + size.trained_bytes;
  const int64_t evidence_px = std::min(size.largest_view_px, kEvidencePixels);
  memory.host.fixed_bytes += size.num_photos * evidence_px * kEvidencePerPixel;
  // Which Gaussians each photo shows.
  memory.host.bytes_per_gaussian = size.num_photos;
  if (kind == BackendKind::kCpu) {
    memory.host.fixed_bytes += kCpuPerPixel * size.largest_view_px;
    memory.host.bytes_per_gaussian += kCpuPerGaussian;
  } else {
    memory.host.fixed_bytes += kHostPerPixel * size.largest_view_px;
    memory.host.bytes_per_gaussian += kHostPerGaussian;
    memory.device.fixed_bytes = size.trained_bytes + kCudaPerPixel * size.largest_view_px;
    memory.device.bytes_per_gaussian = kCudaPerGaussian + kCudaPerGaussian / 2;
  }
  // While photos are read there is no model yet.
  memory.host.fixed_bytes = std::max(memory.host.fixed_bytes, size.photo_bytes + size.loading_bytes);
  memory.host.fixed_bytes += kProgram;
  return memory;
}

void FitTrainingMemory(const TrainingSize& size, BackendKind kind, const MemoryLimits& limits,
                       TrainOptions* options, Reporter& reporter) {
  const TrainingMemory memory = PredictTrainingMemory(size, kind);
  const int64_t first =
      std::min(options->max_gaussians,
               std::min(size.num_points, options->initial.max_points) + 2 * options->initial.min_points);
  const int64_t most =
      std::min(MostGaussians(memory.host, limits.host), MostGaussians(memory.device, limits.device));
  const auto stated = [&](int64_t num_gaussians) {
    std::string text = InMegabytes(memory.host.At(num_gaussians)) + " of memory";
    if (kind == BackendKind::kCuda)
      text += " and " + InMegabytes(memory.device.At(num_gaussians)) + " of the GPU's";
    return text;
  };
  const auto available = [&] {
    constexpr int64_t kUnknown = std::numeric_limits<int64_t>::max();
    std::string text = limits.host < kUnknown ? InMegabytes(limits.host) : "an unknown size";
    if (kind == BackendKind::kCuda) text += " and " + InMegabytes(limits.device);
    return text;
  };
  if (most < first) {
    const int side = FittingSide(size, kind, limits, first);
    throw UserError(
        "training needs about " + stated(first) + " for " + std::to_string(size.num_photos) +
        " photos of up to " + std::to_string(size.longest_side_px) + " px and the first " +
        std::to_string(first) + " Gaussians; it may take " + available() + ". " +
        (side > 0
             ? "Give --max_image_size " + std::to_string(side) + ", or fewer photos"
             : std::string("Give fewer photos, close other programs, or use a machine with more memory")));
  }
  if (most < options->max_gaussians) {
    reporter.Warn("training up to " + std::to_string(options->max_gaussians) +
                  " Gaussians would need about " + stated(options->max_gaussians) + ", and may take " +
                  available() + ": it stops growing at " + std::to_string(most));
    options->max_gaussians = most;
  }
  reporter.Info("training needs at most about " + stated(options->max_gaussians) + ": " +
                InMegabytes(size.photo_bytes) + " are " + std::to_string(size.num_photos) +
                " photos, the rest grows with the model up to " + std::to_string(options->max_gaussians) +
                " Gaussians; it may take " + available());
}

}  // namespace s2gs
