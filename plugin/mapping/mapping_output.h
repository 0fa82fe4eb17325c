#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "plugin/mapping/turntable_mapper_settings.h"
#include "plugin/stage/scan_input.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/placement/place_scan.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/turntable/steady_cameras.h"

namespace s2gs {

/// What turntable_mapper leaves in a workspace: models, turntable.json, top view, labels, and its report
/// (split/turntable_mapper.json) with the verdict. Keeps references.
class MappingOutput {
 public:
  MappingOutput(const TurntableMapperSettings& settings, const Workspace& workspace, const ScanInput& input,
                Reporter& reporter)
      : settings_(settings), workspace_(workspace), input_(input), reporter_(reporter) {}

  std::filesystem::path ReportPath() const {
    return workspace_.ObjectDatabase().parent_path() / "turntable_mapper.json";
  }

  /// Of the report: what is written by none of the functions below is up to the caller.
  nlohmann::json& report() { return report_; }
  void AddSeconds(const std::string& part, double seconds) {
    seconds_[part] = seconds_.value(part, 0.0) + seconds;
  }

  /// Says in the report what a placement found, and how long it took.
  void Describe(const ScanPlacement& placement);

  /// \param steady  features that the candidate's poses are of. \param cameras  bring poses back to where
  /// the tripod stood. \param evidence  of the candidate, where it was gathered before.
  void WriteScene(const ScanFeatures& steady, const SteadyCameras& cameras, ScanCandidate* candidate,
                  std::optional<ScanEvidence> evidence);

  /// SfM's own model, the largest of `models`, which nothing moves in: all photos show one rigid body.
  /// Throws UserError where there is none.
  void WriteOneBody(const std::vector<ColmapModel>& models);

  /// Leaves a report with the verdict where nothing has a place, and throws a UserError that says what to
  /// photograph differently.
  [[noreturn]] void Fail(const std::string& problem);

 private:
  void WriteReport();
  ScanVerdict RecordFailure();

  const TurntableMapperSettings& settings_;
  const Workspace& workspace_;
  const ScanInput& input_;
  Reporter& reporter_;
  nlohmann::json report_ = nlohmann::json::object();
  nlohmann::json seconds_ = nlohmann::json::object();
};

}  // namespace s2gs
