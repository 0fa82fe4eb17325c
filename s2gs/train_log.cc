#include "s2gs/train_log.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>
#include <system_error>
#include <utility>

#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

using Json = nlohmann::ordered_json;

constexpr uint64_t kMaxLogBytes = uint64_t{1} << 28;

// NaN and infinity are no JSON: what was not measured is null.
Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json Begin(const char* event, const LogPoint& point) {
  return {{"stage", "train"},
          {"event", event},
          {"iteration", point.iteration},
          {"progress", point.progress},
          {"wall_s", point.wall_seconds},
          {"cpu_s", point.cpu_seconds},
          {"measuring_s", point.measuring_seconds},
          {"count", point.count},
          {"width", point.width},
          {"height", point.height}};
}

}  // namespace

TrainLog::TrainLog(std::filesystem::path path, int64_t iteration) : path_(std::move(path)) {
  std::error_code ec;
  if (path_.empty() || iteration < 0 || !std::filesystem::exists(path_, ec)) return;
  std::istringstream stream(ReadWholeFile(path_, kMaxLogBytes));
  std::string line;
  while (std::getline(stream, line)) {
    // A damaged line is worth no more than the time it tells of.
    const Json value = Json::parse(line, nullptr, false);
    if (!value.is_object() || !value.contains("iteration") || !value["iteration"].is_number_integer())
      continue;
    if (value["iteration"].get<int64_t>() <= iteration) lines_.push_back(line);
  }
}

void TrainLog::AddLoss(const LogPoint& point, const LossTerms& loss, bool sees_whole_photos) {
  Json line = Begin("loss", point);
  line["whole"] = sees_whole_photos;
  line["loss"] = {{"total", Number(loss.total)},
                  {"l1", Number(loss.l1)},
                  {"dssim", Number(loss.dssim)},
                  {"normal", Number(loss.normal)},
                  {"distortion", Number(loss.distortion)},
                  {"local_consistency", Number(loss.local_consistency)},
                  {"entropy_3d", Number(loss.entropy_3d)},
                  {"entropy_2d", Number(loss.entropy_2d)},
                  {"mask", Number(loss.mask)}};
  lines_.push_back(line.dump());
}

void TrainLog::AddHeldOut(const LogPoint& point, const HeldOutErrors& errors) {
  Json line = Begin("held_out", point);
  line["photos"] = errors.num_photos;
  line["psnr_db"] = Number(errors.psnr);
  line["ssim"] = Number(errors.ssim);
  line["object_psnr_db"] = Number(errors.object_psnr);
  line["object_ssim"] = Number(errors.object_ssim);
  line["mask_iou"] = Number(errors.mask_iou);
  lines_.push_back(line.dump());
}

void TrainLog::AddSights(const LogPoint& point, const SightShares& shares) {
  Json line = Begin("sights", point);
  line["cameras"] = shares.num_cameras;
  line["photos"] = shares.num_photos;
  line["other"] = Number(shares.other);
  line["background"] = Number(shares.background);
  line["alike"] = Number(shares.alike);
  line["never_free"] = Number(shares.never_free);
  lines_.push_back(line.dump());
}

void TrainLog::AddNote(const LogPoint& point, const std::string& note) {
  Json line = Begin("note", point);
  line["note"] = note;
  lines_.push_back(line.dump(-1, ' ', false, Json::error_handler_t::replace));
}

void TrainLog::AddDecision(const LogPoint& point, const TrainDecision& decision) {
  Json line = Begin("decision", point);
  line["part"] = decision.part;
  line["left_out"] = decision.is_left_out;
  line["measured"] = decision.measured;
  line["threshold"] = decision.threshold;
  line["reason"] = decision.reason;
  line["saving"] = decision.saving;
  lines_.push_back(line.dump(-1, ' ', false, Json::error_handler_t::replace));
}

void TrainLog::Write() const {
  if (path_.empty()) return;
  WriteFileAtomically(path_, [&](std::ostream& stream) {
    for (const std::string& line : lines_) stream << line << '\n';
  });
}

}  // namespace s2gs
