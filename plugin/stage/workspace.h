#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Where everything lies in a workspace. Only names paths: nothing is created or checked.
struct Workspace {
  using Path = std::filesystem::path;

  Path root;

  Path Images() const { return root / "images"; }
  /// What photo_importer made of photos that came as something else.
  Path Imported() const { return root / "imported"; }
  Path Database() const { return root / "database.db"; }  ///< COLMAP's, untouched by the split.

  // The database with the two_view_geometries of one motion; keypoint indices are those of Database().
  Path ObjectDatabase() const { return root / "split" / "object.db"; }
  Path StaticDatabase() const { return root / "split" / "static.db"; }
  Path SplitLabels() const { return root / "split" / "labels.json"; }
  Path SplitOverlays() const { return root / "split" / "overlays"; }

  Path TurntableMapper() const { return root / "split" / "turntable_mapper.json"; }  ///< what it found.
  Path ScaleReport() const { return root / "split" / "scale.json"; }                 ///< of model_scaler.
  Path TopView() const { return root / "split" / "top_view.svg"; }

  Path ObjectModel() const { return root / "sparse" / "0"; }       ///< poses are cam_from_object.
  Path StaticModel() const { return root / "sparse" / "static"; }  ///< poses are cam_from_world.
  Path Turntable() const { return root / "turntable.json"; }

  /// COLMAP's convention: the mask of a.jpg is a.jpg.png; 255 is the rotating part.
  Path Masks() const { return root / "masks"; }
  Path Mask(const std::string& image_name) const { return Masks() / (image_name + ".png"); }

  // As COLMAP's image_undistorter leaves it; depth and normal maps are named as patch_match_stereo names
  // them.
  Path Dense() const { return root / "dense" / "0"; }
  Path DenseImages() const { return Dense() / "images"; }
  Path DenseModel() const { return Dense() / "sparse"; }
  Path DepthMaps() const { return Dense() / "stereo" / "depth_maps"; }
  Path NormalMaps() const { return Dense() / "stereo" / "normal_maps"; }
  /// Silhouettes of the rotating part alone for DenseImages(), as if nothing stood in front of it: NAME.png.
  Path DenseMasks() const { return Dense() / "masks"; }
  /// Where photos show the top of a table that turns, so that nothing stands before it: 255 in NAME.png.
  Path TableSeen() const { return Dense() / "table_seen"; }
  // To read; what is written goes through ImageOutputs.
  Path DepthMap(const std::string& image_name) const { return DepthMaps() / (image_name + ".geometric.bin"); }
  Path NormalMap(const std::string& image_name) const {
    return NormalMaps() / (image_name + ".geometric.bin");
  }
  Path TsdfMesh() const { return Dense() / "meshed-tsdf.ply"; }
  Path TexturedMesh() const { return Dense() / "textured-tsdf"; }  ///< without the extensions.
  std::vector<Path> TexturedMeshFiles() const;                     ///< all but the further pages.
  Path PoissonMesh() const { return Dense() / "meshed-poisson.ply"; }
  Path DelaunayMesh() const { return Dense() / "meshed-delaunay.ply"; }

  // What only s2gs reads.
  Path Own() const { return root / "s2gs"; }
  Path PointCloud() const { return Own() / "point_cloud.ply"; }
  Path Overview() const { return Own() / "comparison.jpg"; }
  Path Checkpoints() const { return Own() / "checkpoints"; }
  Path Plan() const { return Own() / "plan.json"; }
  Path Log() const { return Own() / "log.jsonl"; }
  Path MaskLog() const { return Own() / "mask_log.jsonl"; }      ///< what masks rest on beside p.
  Path MeshLog() const { return Own() / "mesh_log.jsonl"; }      ///< error over time of the mesh.
  Path ScanRecord() const { return Own() / "scan.json"; }        ///< the scanner's last run.
  Path ImportRecord() const { return Own() / "imported.json"; }  ///< the names that it wrote.
  Path Stages() const { return Own() / "stages"; }
  Path StageStamp(const std::string& stage) const { return Stages() / (stage + ".json"); }
  Path LockFile() const { return Own() / "lock"; }           ///< of the command that works in it.
  Path ScanLockFile() const { return Own() / "scan_lock"; }  ///< of the scanner, between its commands too.
  Path BatchRecord() const { return Own() / "batch.json"; }  ///< how scan_batch's last run of it ended.
  Path BatchLog() const { return Own() / "batch.log"; }      ///< and what it said.

  Path ReportHtml() const { return root / "report.html"; }
  Path ReportJson() const { return root / "report.json"; }
};

/// A stage of the pipeline and what it promises to write.
struct StandardStage {
  std::string name;
  std::vector<std::filesystem::path> outputs;
  std::string command;  ///< that runs it.
};

/// The stages from photos to report, in order.
std::vector<StandardStage> StandardStages(const Workspace& workspace);

/// The files and folders of a workspace, each with a phrase that says what it is, in the order of the stages.
std::vector<std::pair<std::filesystem::path, std::string>> WorkspaceContents(const Workspace& workspace);

/// Keeps other runs of s2gs out of a workspace for as long as it exists, even when the process is killed.
class WorkspaceLock {
 public:
  /// Throws UserError when the workspace is no folder, its own folder is or holds a link out of it, or
  /// another process works in it. Where the file system knows no locks, warns and goes on. A workspace that
  /// was used before may be read-only.
  WorkspaceLock(const Workspace& workspace, Reporter& reporter);
  /// The same with another file of the workspace's own folder.
  WorkspaceLock(const Workspace& workspace, const std::filesystem::path& file, Reporter& reporter);
  WorkspaceLock(const WorkspaceLock&) = delete;
  WorkspaceLock& operator=(const WorkspaceLock&) = delete;
  ~WorkspaceLock();

 private:
  int fd_ = -1;
};

/// The number of the process that holds a lock's file, empty where it is not known; nothing when none does.
std::optional<std::string> OwnerOfLock(const std::filesystem::path& file);

/// Removes what killed runs left half-written anywhere in the workspace but among the photos.
void RemoveStaleWorkspaceTemporaries(const Workspace& workspace);

}  // namespace s2gs
