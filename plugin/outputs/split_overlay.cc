#include "plugin/outputs/split_overlay.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "s2gs/image/exif.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/image_name.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

struct Dot {
  std::array<uint8_t, 3> color;
  double radius;  // share of the photo's longest side
};

const Dot& DotOf(KeypointLabel label) {
  static const Dot unknown{{150, 150, 150}, 0.0015};
  static const Dot still{{40, 120, 255}, 0.003};
  static const Dot rotating{{255, 110, 0}, 0.004};
  if (label == KeypointLabel::kUnknown) return unknown;
  return label == KeypointLabel::kStatic ? still : rotating;
}

void Draw(const Eigen::Vector2f& xy, const Dot& dot, Image8* image) {
  const double radius = std::max(0.6, dot.radius * std::max(image->width, image->height));
  const int x0 = std::max(0, static_cast<int>(std::floor(xy.x() - radius)));
  const int y0 = std::max(0, static_cast<int>(std::floor(xy.y() - radius)));
  const int x1 = std::min(image->width - 1, static_cast<int>(std::ceil(xy.x() + radius)));
  const int y1 = std::min(image->height - 1, static_cast<int>(std::ceil(xy.y() + radius)));
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      if (std::hypot(x + 0.5 - xy.x(), y + 0.5 - xy.y()) <= radius)
        std::copy(dot.color.begin(), dot.color.end(), image->Pixel(x, y));
    }
  }
}

// Darker photos let the dots stand out.
void Dim(Image8* image) {
  for (uint8_t& value : image->pixels) value = static_cast<uint8_t>(value * 7 / 10);
}

std::vector<std::string> NamesOf(const SplitFeatures& features) {
  std::vector<std::string> names;
  names.reserve(features.images.size());
  for (const SplitImage& image : features.images) names.push_back(image.name);
  return names;
}

}  // namespace

int WriteSplitOverlays(const fs::path& folder, const fs::path& image_path, const SplitFeatures& features,
                       const MotionSplit& split, int max_photos, Reporter& reporter) {
  const auto num = static_cast<int64_t>(features.images.size());
  const int64_t num_drawn = std::min<int64_t>(num, max_photos);
  const ImageOutputs outputs(folder, image_path, NamesOf(features));
  int num_written = 0;
  for (int64_t d = 0; d < num_drawn; ++d) {
    if (reporter.StopRequested()) throw Interrupted();
    reporter.Progress("draw overlays", d, num_drawn);
    const auto i = static_cast<size_t>(d * num / num_drawn);
    const SplitImage& of_image = features.images[i];
    try {
      Image8 image = ReadImage(image_path / of_image.name, 3);
      Dim(&image);
      for (const KeypointLabel label :
           {KeypointLabel::kUnknown, KeypointLabel::kStatic, KeypointLabel::kRotating}) {
        for (size_t k = 0; k < of_image.keypoints.size(); ++k) {
          if (split.labels[i][k] == label) Draw(of_image.keypoints[k], DotOf(label), &image);
        }
      }
      const std::string suffix = fs::path(of_image.name).extension() == ".jpg" ? "" : ".jpg";
      image = TurnUpright(image, ReadOrientation(image_path / of_image.name));
      WriteImage(outputs.Make(folder, ImageName(of_image.name, image_path), suffix), image, 88);
      ++num_written;
    } catch (const UserError& error) {
      reporter.Warn(std::string("no overlay of ") + of_image.name + ": " + error.what());
    }
  }
  if (num_drawn > 0) reporter.Progress("draw overlays", num_drawn, num_drawn);
  return num_written;
}

}  // namespace s2gs
