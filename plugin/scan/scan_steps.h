#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "plugin/photos/photo_import.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/scan/scan_preflight.h"
#include "plugin/shared_options/quality.h"
#include "plugin/shared_options/scale_options.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// The last part of a scan to run.
enum class ScanUntil : uint8_t { kSplit, kTrain, kMesh };

/// What a scan is told, and what was found of its photos before it begins.
struct ScanSettings {
  std::filesystem::path workspace_path;
  std::filesystem::path given_path;  ///< the photos as they came: a folder or a video
  std::filesystem::path image_path;  ///< what the commands read: the same, or what was imported
  std::optional<ImportPlan> import;
  bool is_video = false;
  int video_frames = 120;
  std::filesystem::path ffmpeg_path;
  std::filesystem::path mask_path;
  std::filesystem::path colmap_path;
  Quality quality = Quality::kAuto;
  ScanUntil until = ScanUntil::kMesh;
  std::string use_gpu = "auto";
  bool has_gpu = true;  ///< that may be used: without one quality auto is low.
  int test_every = 0;
  std::optional<int64_t> num_iterations;
  std::optional<int> first_octave;
  std::string camera_params;  ///< of SIMPLE_RADIAL, where they are known: "f,cx,cy,k" [px].
  std::optional<int32_t> max_image_size;
  bool keep_disc = true;
  std::string plain_table = "object";
  bool texture = true;
  ScaleOptions scale;
  std::filesystem::path angles_path;
  double step_deg = 0;
  std::vector<std::string> force;  ///< as given
  std::set<std::string> forced;    ///< parts of the plan

  uint64_t random_seed = 0;
  LogLevel log_level = LogLevel::kInfo;

  bool Imports() const { return is_video || import.has_value(); }
  bool IsLow() const { return quality == Quality::kLow || (quality == Quality::kAuto && !has_gpu); }
};

/// A command of this program, as the scanner runs it.
struct ScanStep {
  std::string command;
  std::string title;
  std::vector<std::string> arguments;
};

/// All but the report, in order.
std::vector<ScanStep> ScanSteps(const ScanSettings& settings);
ScanStep ReportStep(const ScanSettings& settings);

/// What is checked before anything runs.
ScanRequest RequestOf(const ScanSettings& settings, const std::vector<ScanStep>& steps);
/// What the plan is made for.
PlanRequest PlanOf(const ScanSettings& settings);

}  // namespace s2gs
