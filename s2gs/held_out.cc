#include "s2gs/held_out.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "s2gs/rotating_mask.h"

namespace s2gs {
namespace {

struct Mean {
  double sum = 0;
  int64_t count = 0;
  void Add(double value) {
    if (std::isnan(value)) return;
    sum += value;
    ++count;
  }
  double Value() const {
    return count > 0 ? sum / static_cast<double>(count) : std::numeric_limits<double>::quiet_NaN();
  }
};

double Iou(const PixelMask& a, const PixelMask& b) {
  int64_t both = 0;
  int64_t any = 0;
  for (size_t i = 0; i < a.inside.size(); ++i) {
    both += a.inside[i] & b.inside[i];
    any += a.inside[i] | b.inside[i];
  }
  return any > 0 ? static_cast<double>(both) / static_cast<double>(any) : 0;
}

}  // namespace

Image8 ToImage8(const RenderedView& view) {
  Image8 image{view.width, view.height, 3, {}};
  image.pixels.reserve(view.color.size());
  for (const float value : view.color) {
    // NaN becomes 0.
    const float bounded = value > 0 ? std::min(value, 1.0F) : 0.0F;
    image.pixels.push_back(static_cast<uint8_t>(bounded * 255 + 0.5F));
  }
  return image;
}

HeldOutErrors MeasureHeldOut(const TrainingScene& scene, Backend* backend) {
  Mean psnr;
  Mean ssim;
  Mean object_psnr;
  Mean object_ssim;
  Mean iou;
  HeldOutErrors errors;
  std::optional<RotatingShape> shape;
  if (scene.mode == TrainMode::kS2gs) shape = FindRotatingShape(scene, backend->GetGaussians());
  for (const ScenePhoto& photo : scene.photos) {
    if (!photo.held_out) continue;
    ++errors.num_photos;
    RenderRequest request;
    request.view = photo.view;
    request.bodies = scene.bodies();
    const RenderedView view = backend->Render(request);
    const Image8 image = ToImage8(view);
    const SsimMap similarity = ComputeSsim(image, photo.image);
    psnr.Add(Psnr(image, photo.image));
    ssim.Add(similarity.Mean());
    const std::vector<uint8_t>& truth = photo.truth_mask.empty() ? photo.mask : photo.truth_mask;
    if (truth.empty()) continue;
    PixelMask mask{photo.view.width, photo.view.height, {}};
    mask.inside.reserve(truth.size());
    for (const uint8_t value : truth) mask.inside.push_back(value > 127 ? 1 : 0);
    object_psnr.Add(Psnr(image, photo.image, &mask));
    object_ssim.Add(similarity.Mean(mask));
    iou.Add(Iou(RotatingMask(backend->Render(MaskRequest(scene, shape, photo.view))), mask));
  }
  errors.psnr = psnr.Value();
  errors.ssim = ssim.Value();
  errors.object_psnr = object_psnr.Value();
  errors.object_ssim = object_ssim.Value();
  errors.mask_iou = iou.Value();
  return errors;
}

}  // namespace s2gs
