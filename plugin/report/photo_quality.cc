#include "plugin/report/photo_quality.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "plugin/report/html_writer.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr double kFalseAlarms = 0.05;  // in a scan
constexpr double kBlurUnitPx = 0.5;
constexpr double kExposureUnitStops = 1.0 / 3;
constexpr double kGamma = 2.2;
constexpr size_t kMinStation = 5;

// The z above which a normal variable lies with this probability, by bisection.
double NormalQuantile(double tail) {
  double low = 0;
  double high = 40;
  for (int i = 0; i < 80; ++i) {
    const double z = (low + high) / 2;
    (0.5 * std::erfc(z / std::sqrt(2.0)) > tail ? low : high) = z;
  }
  return low;
}

struct Spread {
  double median = 0;
  double sigma = 0;
};

Spread SpreadOf(const std::vector<double>& values) {
  Spread spread;
  spread.median = Summarize(values).median;
  std::vector<double> deviations;
  deviations.reserve(values.size());
  for (const double value : values) deviations.push_back(std::abs(value - spread.median));
  spread.sigma = kSigmaOfMad * Summarize(deviations).median;
  return spread;
}

double Stops(const PhotoQuality& photo) { return kGamma * std::log2(std::max(photo.brightness, 1e-3)); }

class InMask {
 public:
  InMask(const Image8& grey, const Image8* mask) : grey_(grey), mask_(mask) {}
  bool operator()(int x, int y) const {
    const auto at = [](int i, int size, int from) {
      return static_cast<int>(static_cast<int64_t>(i) * size / from);
    };
    return *mask_->Pixel(at(x, mask_->width, grey_.width), at(y, mask_->height, grey_.height)) > 127;
  }

 private:
  const Image8& grey_;
  const Image8* mask_;
};

struct Sums {
  double gradients = 0;
  double laplacians = 0;
  double values = 0;
  int64_t count = 0;
};

}  // namespace

PhotoQuality MeasurePhoto(const Image8& grey, const Image8* mask) {
  Sums inside;
  Sums outside;
  int64_t bright = 0;
  int64_t dark = 0;
  const bool has_mask = mask != nullptr && mask->width > 0 && mask->height > 0;
  const InMask in_mask(grey, mask);
  for (int y = 0; y < grey.height; ++y) {
    for (int x = 0; x < grey.width; ++x) {
      const int value = *grey.Pixel(x, y);
      bright += value >= 254 ? 1 : 0;
      dark += value <= 1 ? 1 : 0;
      Sums& sums = has_mask && in_mask(x, y) ? inside : outside;
      sums.values += value;
      ++sums.count;
      if (x == 0 || y == 0 || x + 1 == grey.width || y + 1 == grey.height) continue;
      const int left = *grey.Pixel(x - 1, y);
      const int right = *grey.Pixel(x + 1, y);
      const int above = *grey.Pixel(x, y - 1);
      const int below = *grey.Pixel(x, y + 1);
      const double gx = 0.5 * (right - left);
      const double gy = 0.5 * (below - above);
      const double laplacian = left + right + above + below - 4 * value;
      sums.gradients += gx * gx + gy * gy;
      sums.laplacians += laplacian * laplacian;
    }
  }
  PhotoQuality quality;
  const int64_t pixels = inside.count + outside.count;
  if (pixels == 0) return quality;
  quality.is_read = true;
  const Sums& sharp = inside.count > 0 ? inside : outside;
  quality.blur_px = sharp.laplacians > 0 ? std::sqrt(sharp.gradients / (2 * sharp.laplacians))
                                         : std::numeric_limits<double>::infinity();
  const Sums& lit = outside.count > 0 ? outside : inside;
  quality.brightness = lit.values / (255.0 * static_cast<double>(lit.count));
  quality.bright_pct = 100.0 * static_cast<double>(bright) / static_cast<double>(pixels);
  quality.dark_pct = 100.0 * static_cast<double>(dark) / static_cast<double>(pixels);
  return quality;
}

std::vector<PhotoWarning> FindPhotoWarnings(const std::vector<PhotoQuality>& photos,
                                            const std::vector<int>& stations) {
  std::map<int, std::vector<size_t>> by_station;
  size_t num_read = 0;
  for (size_t i = 0; i < photos.size(); ++i) {
    if (!photos[i].is_read) continue;
    by_station[stations[i]].push_back(i);
    ++num_read;
  }
  std::vector<PhotoWarning> warnings;
  if (num_read == 0) return warnings;
  // Too blurred, too dark and too bright are three ways to stand out.
  const double z = NormalQuantile(kFalseAlarms / (3 * static_cast<double>(num_read)));
  for (const auto& [station, members] : by_station) {
    if (members.size() < kMinStation) continue;
    std::vector<double> blur;
    std::vector<double> stops;
    for (const size_t i : members) {
      // A photo without any edge, a black one say, has no blur to compare.
      if (std::isfinite(photos[i].blur_px)) blur.push_back(photos[i].blur_px);
      stops.push_back(Stops(photos[i]));
    }
    const Spread blurs = SpreadOf(blur);
    const Spread exposures = SpreadOf(stops);
    for (const size_t i : members) {
      const double above = photos[i].blur_px - blurs.median;
      if (std::isfinite(above) && above > z * blurs.sigma && above > 0) {
        // Blurs add as variances.
        const double added = std::sqrt(photos[i].blur_px * photos[i].blur_px - blurs.median * blurs.median);
        if (added > kBlurUnitPx) {
          warnings.push_back({i, fmt::format("blurred by {} px more than its station's photos ({} px)",
                                             Significant(added, 2), Significant(blurs.median, 2))});
        }
      }
      const double off = Stops(photos[i]) - exposures.median;
      if (std::abs(off) > z * exposures.sigma && std::abs(off) > kExposureUnitStops) {
        warnings.push_back({i, fmt::format("{} stops {} than its station's photos",
                                           Significant(std::abs(off), 2), off > 0 ? "brighter" : "darker")});
      }
    }
  }
  return warnings;
}

}  // namespace s2gs
