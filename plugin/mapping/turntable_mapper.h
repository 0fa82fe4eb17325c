#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "plugin/colmap/colmap_process.h"
#include "plugin/mapping/mapping_output.h"
#include "plugin/mapping/turntable_mapper_settings.h"
#include "plugin/stage/scan_input.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/circular_search.h"
#include "sfm_split/placement/place_scan.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/turntable/steady_cameras.h"

namespace s2gs {

/// What a scan's split leads to: both bodies mapped by COLMAP, the photos placed, and what that came to in
/// the workspace. Keeps references. Each part may be left to an earlier run, which left it in the workspace.
class TurntableMapper {
 public:
  TurntableMapper(const TurntableMapperSettings& settings, const Workspace& workspace, Reporter& reporter)
      : settings_(settings),
        workspace_(workspace),
        reporter_(reporter),
        split_(workspace.ObjectDatabase().parent_path()),
        output_(settings, workspace_, input_, reporter) {}

  std::filesystem::path ObjectFolder() const { return split_ / "object_model"; }
  std::filesystem::path BackgroundFolder() const { return split_ / "static_model"; }
  std::filesystem::path ReportPath() const { return output_.ReportPath(); }

  /// Before all that follows. Throws UserError where the split has not run.
  void ReadInput() { input_ = ReadScanInput(workspace_); }
  /// What is stated of the table's angles goes into the options of the adjustment.
  void ReadStatedAngles(TurntableMapperSettings* settings) const;
  const ScanInput& input() const { return input_; }
  bool HasBackground() const;

  /// Begins a part of PlaceByCircle() and Place() that needs no model, while COLMAP's mapper makes the
  /// object's on one thread. They find it in the options.
  void BeginCircularSearch(TurntableMapperSettings* settings);
  /// Models of a body by `colmap mapper`, with attempts.json beside them.
  void Map(bool of_object, ColmapProgram* colmap, Reporter& reporter) const;
  /// Whether circular motion is asked whether it does without the object's model.
  bool TriesCircleFirst() const {
    return settings_.circle_first && settings_.placement.path == PlacementPath::kAuto &&
           input_.capture_case != CaptureCase::kOneBody;
  }
  /// Whether it does. Place() writes what it came to; otherwise it says why not. May be called from another
  /// thread than the one that made this.
  bool PlaceByCircle(Reporter& reporter);
  /// Places the photos, and writes what that came to. Throws UserError where they have no place.
  void Place();

 private:
  // Photos as cameras that stand still would have taken them, and what was found of them.
  struct Steadied {
    SteadyCameras cameras;
    std::optional<ScanFeatures> features;  // none: no camera moved

    void Steady(std::vector<ColmapModel>* models) const {
      if (!features) return;
      for (ColmapModel& model : *models) model = cameras.Steady(model);
    }
  };
  Steadied Steady(const std::map<uint32_t, Camera>& cameras) const;
  const ScanFeatures& FeaturesOf(const Steadied& steadied) const {
    return steadied.features ? *steadied.features : input_.features;
  }
  ReadGreyPhoto PhotosOf(const SteadyCameras& cameras) const;
  std::vector<uint8_t> ReadDescriptorsOf(const ColmapDatabase& database, int image) const;
  GreyPhoto ReadPhoto(const std::string& name) const;
  void ReportInput();
  void SayTurn(const Steadied& steadied);
  void PlaceWithModels(const ReadDescriptors& read_descriptors, std::vector<ColmapModel> objects,
                       std::vector<ColmapModel> backgrounds);
  void JoinStations(const std::vector<ColmapModel>& objects, const ReadDescriptors& read_descriptors,
                    Steadied* steadied, ScanPlacement* placement);
  void PlaceOneBody(const ReadDescriptors& read_descriptors, const std::vector<ColmapModel>& objects);
  bool PlaceBeforeCamera(const ReadDescriptors& read_descriptors, const std::vector<ColmapModel>& objects);
  void WritePlaced(const Steadied& steadied, ScanPlacement* placement);

  const TurntableMapperSettings& settings_;
  Workspace workspace_;
  Reporter& reporter_;
  std::filesystem::path split_;
  ScanInput input_;
  MappingOutput output_;
  std::optional<std::pair<Steadied, ScanPlacement>> by_circle_;
  std::string not_by_circle_;  // why circular motion did not do; empty: it was not asked, or it did
  std::optional<CircularSearch> circular_search_;  // after what it searches, so that it ends first
};

}  // namespace s2gs
