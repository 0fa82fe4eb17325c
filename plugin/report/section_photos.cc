#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <system_error>

#include "plugin/report/data_uri.h"
#include "plugin/report/photo_quality.h"
#include "plugin/report/residuals.h"
#include "plugin/report/sections.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Thumbnails of all photos together take about half a megabyte: about 0.36 characters a pixel at this quality
// (60 photos of a cluttered desk).
constexpr double kThumbnailPixels = 1.4e6;
constexpr int kThumbnailQuality = 72;
constexpr int kMaxThumbnail = 200;  // longer side [px]
constexpr int kMinThumbnail = 48;

struct Photo {
  std::string name;
  int station = -1;
  bool is_turned = true;  ///< false: its station and angle say nothing.
  double angle_deg = std::numeric_limits<double>::quiet_NaN();
  double object_rms_px = std::numeric_limits<double>::quiet_NaN();
  double background_rms_px = std::numeric_limits<double>::quiet_NaN();
  size_t object_keypoints = 0;
  size_t background_keypoints = 0;
  bool is_placed = false;
  std::string missing;  // why it has no pose
  std::string mended;   // how it got its pose, if not from SfM
  PhotoQuality quality;
  std::vector<std::string> warnings;
  std::string thumbnail;  // data URI; empty: the photo cannot be read
};

int ThumbnailSide(size_t num_photos) {
  const double side = std::sqrt(kThumbnailPixels / static_cast<double>(std::max<size_t>(1, num_photos)));
  return std::clamp(static_cast<int>(side), kMinThumbnail, kMaxThumbnail);
}

std::set<std::string> Names(const nlohmann::json& mapper, const char* key) {
  std::set<std::string> names;
  if (!mapper.is_object() || !mapper.contains(key) || !mapper[key].is_array()) return names;
  for (const auto& entry : mapper[key]) {
    if (entry.is_string()) names.insert(entry.get<std::string>());
    if (entry.is_object()) names.insert(entry.value("name", ""));
  }
  return names;
}

// Why a photo has no pose, as far as the mapper said.
std::string WhyMissing(const ReportInput& input, const std::string& name,
                       const std::set<std::string>& doubted) {
  if (input.mapper.is_null()) return "the poses have not been computed yet";
  if (doubted.count(name) > 0) return "its matches contradict the poses of the other photos";
  if (input.split && input.split->images.count(name) == 0) return "it has no features";
  return "too few of its matches on the rotating part agree on one table angle";
}

void LookAt(const ReportInput& input, int side, Photo* photo) {
  const Image8 image = ReadImage(input.image_path / photo->name, 3);
  const Image8 grey = GreyImage(image);
  const fs::path mask_path = input.workspace.Mask(photo->name);
  std::error_code ec;
  std::optional<Image8> mask;
  if (fs::exists(mask_path, ec)) mask = ReadImage(mask_path, 1);
  photo->quality = MeasurePhoto(grey, mask ? &*mask : nullptr);
  const int orientation = ReadOrientation(input.image_path / photo->name);
  photo->thumbnail = JpegDataUri(TurnUpright(Thumbnail(image, side), orientation), kThumbnailQuality);
}

// Thumbnails, and what stands out among the photos; those that cannot be read are warned about.
void LookAtAll(const ReportInput& input, Reporter& reporter, std::vector<Photo>* photos) {
  std::vector<std::string> problems(photos->size());
  const int side = ThumbnailSide(photos->size());
  const int threads = std::clamp(NumThreadsOf(0), 1, 8);
  // In parts, so that progress and Ctrl-C come from this thread.
  const size_t part = 8 * static_cast<size_t>(threads);
  for (size_t first = 0; first < photos->size(); first += part) {
    if (reporter.StopRequested()) throw Interrupted();
    reporter.Progress("look at photos", static_cast<int64_t>(first), static_cast<int64_t>(photos->size()));
    const size_t count = std::min(part, photos->size() - first);
    ParallelFor(static_cast<int64_t>(count), threads, [&](int64_t i) {
      const size_t at = first + static_cast<size_t>(i);
      try {
        LookAt(input, side, &(*photos)[at]);
      } catch (const UserError& error) {
        problems[at] = error.what();
      }
    });
  }
  if (!photos->empty()) {
    const auto total = static_cast<int64_t>(photos->size());
    reporter.Progress("look at photos", total, total);
  }
  for (const std::string& problem : problems) {
    if (!problem.empty()) reporter.Warn("no thumbnail: " + problem);
  }
  std::vector<PhotoQuality> qualities;
  std::vector<int> stations;
  for (const Photo& photo : *photos) {
    qualities.push_back(photo.quality);
    stations.push_back(photo.station);
  }
  for (const PhotoWarning& warning : FindPhotoWarnings(qualities, stations)) {
    (*photos)[warning.photo].warnings.push_back(warning.text);
  }
}

std::vector<Photo> CollectPhotos(const ReportInput& input, Reporter& reporter) {
  const std::set<std::string> untied = Names(input.mapper, "untied");
  const std::set<std::string> doubted = Names(input.mapper, "doubted");
  ModelResiduals object;
  ModelResiduals background;
  if (input.object) object = ComputeResiduals(*input.object);
  if (input.background) background = ComputeResiduals(*input.background);
  std::vector<Photo> photos;
  for (const std::string& name : input.photos) {
    Photo photo;
    photo.name = name;
    photo.station = input.StationOf(name);
    photo.is_turned = !input.turntable || input.ShowsATurn();
    if (const TurntableImage* image = input.TableImage(name)) photo.angle_deg = image->angle_deg;
    if (const ColmapImage* image = input.ObjectImage(name)) {
      photo.is_placed = true;
      const auto found = object.by_image.find(image->image_id);
      if (found != object.by_image.end()) {
        photo.object_rms_px = RmsLength(found->second);
        photo.object_keypoints = found->second.size();
      }
    }
    if (const ColmapImage* image = input.BackgroundImage(name)) {
      const auto found = background.by_image.find(image->image_id);
      if (found != background.by_image.end()) {
        photo.background_rms_px = RmsLength(found->second);
        photo.background_keypoints = found->second.size();
      }
    }
    if (!photo.is_placed) photo.missing = WhyMissing(input, name, doubted);
    if (untied.count(name) > 0)
      photo.warnings.emplace_back("nothing on the background ties its station to the others");
    photos.push_back(std::move(photo));
  }
  if (input.mapper.is_object() && input.mapper.contains("mended")) {
    for (const auto& mended : input.mapper["mended"]) {
      const std::string name = mended.value("name", "");
      const auto found =
          std::lower_bound(photos.begin(), photos.end(), name,
                           [](const Photo& photo, const std::string& n) { return photo.name < n; });
      if (found != photos.end() && found->name == name) found->mended = mended.value("how", "");
    }
  }
  if (!input.image_path.empty()) LookAtAll(input, reporter, &photos);
  return photos;
}

// As the dial counts: 0 to 360 degrees, and no 360 by rounding.
double FullTurn(double angle_deg) {
  const double turned = angle_deg - 360 * std::floor(angle_deg / 360);
  return turned >= 359.995 ? 0 : turned;
}

void WriteCard(const Photo& photo, HtmlWriter* out) {
  std::string kind = "photo";
  if (!photo.is_placed) kind += " lost";
  if (!photo.warnings.empty()) kind += " warned";
  const auto sort_key = [](double value) { return std::isfinite(value) ? fmt::format("{:.6g}", value) : ""; };
  out->Open("li", {{"class", kind},
                   {"data-name", photo.name},
                   {"data-residual", sort_key(photo.object_rms_px)},
                   {"data-keypoints", std::to_string(photo.object_keypoints)},
                   {"data-blur", photo.quality.is_read ? sort_key(photo.quality.blur_px) : ""},
                   {"data-brightness", photo.quality.is_read ? sort_key(photo.quality.brightness) : ""}});
  if (photo.thumbnail.empty()) {
    out->Element("div", "cannot be shown", {{"class", "blank"}});
  } else {
    out->Void("img", {{"src", photo.thumbnail}, {"alt", photo.name}, {"decoding", "async"}});
  }
  out->Element("b", photo.name);
  std::string where;
  if (photo.is_turned && photo.station >= 0) where = "station " + std::to_string(photo.station);
  if (photo.is_turned && std::isfinite(photo.angle_deg))
    where += fmt::format(", {}°", ShortNumber(FullTurn(photo.angle_deg), 2));
  if (!where.empty()) out->Element("span", where);
  if (photo.object_keypoints > 0) {
    out->Element("span", fmt::format("{} px over {}", Significant(photo.object_rms_px, 2),
                                     Count(photo.object_keypoints, "keypoint")));
  }
  if (photo.quality.is_read) {
    out->Element("span", fmt::format("edges {} px wide", Significant(photo.quality.blur_px, 2)));
  }
  if (!photo.is_placed) out->Element("em", "no pose: " + photo.missing);
  if (!photo.mended.empty()) out->Element("em", "placed afterwards: " + photo.mended, {{"class", "mild"}});
  for (const std::string& warning : photo.warnings) out->Element("em", warning, {{"class", "mild"}});
  out->Close();
}

nlohmann::ordered_json ToJson(const Photo& photo) {
  nlohmann::ordered_json json = {{"name", photo.name},
                                 {"station", photo.station},
                                 {"angle_deg", FiniteOrNull(photo.angle_deg)},
                                 {"placed", photo.is_placed},
                                 {"object_keypoints", photo.object_keypoints},
                                 {"object_rms_px", FiniteOrNull(photo.object_rms_px)},
                                 {"background_keypoints", photo.background_keypoints},
                                 {"background_rms_px", FiniteOrNull(photo.background_rms_px)}};
  if (!photo.missing.empty()) json["missing"] = photo.missing;
  if (!photo.mended.empty()) json["mended"] = photo.mended;
  if (photo.quality.is_read) {
    json["blur_px"] = FiniteOrNull(photo.quality.blur_px);
    json["brightness"] = photo.quality.brightness;
    json["bright_pct"] = photo.quality.bright_pct;
    json["dark_pct"] = photo.quality.dark_pct;
  }
  if (!photo.warnings.empty()) json["warnings"] = photo.warnings;
  return json;
}

}  // namespace

ReportSection PhotosSection(const ReportInput& input, Reporter& reporter) {
  ReportSection section{"photos", "Photos", {}, {}};
  section.numbers = nlohmann::ordered_json::array();
  HtmlWriter& out = section.html;
  std::vector<Photo> photos = CollectPhotos(input, reporter);
  if (photos.empty()) {
    WriteMissing("No photos are known yet.", &out);
    return section;
  }
  if (input.image_path.empty()) {
    WriteMissing("The photos are not where the scan found them; --image_path says where they are now.", &out);
  }
  size_t lost = 0;
  size_t warned = 0;
  for (const Photo& photo : photos) {
    section.numbers.push_back(ToJson(photo));
    lost += photo.is_placed ? 0 : 1;
    warned += photo.warnings.empty() ? 0 : 1;
  }
  // Those to look at come first.
  std::stable_sort(photos.begin(), photos.end(), [](const Photo& a, const Photo& b) {
    const auto rank = [](const Photo& photo) {
      return photo.is_placed ? (photo.warnings.empty() ? 2 : 1) : 0;
    };
    return rank(a) < rank(b);
  });
  out.Element("p", fmt::format("{}, {} without a pose, {} with a warning.", Count(photos.size(), "photo"),
                               lost, warned));
  out.Open("p", {{"class", "controls"}, {"data-sort", "photo-list"}}).Text("Sort by ");
  for (const auto& [key, label] :
       {std::pair("name", "name"), std::pair("residual", "residual"), std::pair("keypoints", "keypoints"),
        std::pair("blur", "blur"), std::pair("brightness", "brightness")}) {
    out.Element("button", label, {{"type", "button"}, {"data-key", key}});
  }
  out.Close();
  out.Open("ul", {{"class", "photos"}, {"id", "photo-list"}});
  for (const Photo& photo : photos) WriteCard(photo, &out);
  out.Close();
  out.Element(
      "p",
      "Residual: root mean square over the keypoints of the rotating part. Blur: standard deviation of the "
      "edges on the rotating part, where there is a mask. A photo is warned about when it stands out from "
      "its "
      "station's by more than chance allows, and by half a pixel of blur or a third of a stop at least.",
      {{"class", "note"}});
  return section;
}

}  // namespace s2gs
