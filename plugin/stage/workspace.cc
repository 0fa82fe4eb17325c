#include "plugin/stage/workspace.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string_view>
#include <system_error>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {

namespace fs = std::filesystem;

namespace {

// Whoever only asks who owns a lock holds it for a moment.
constexpr int kLockTries = 5;
constexpr useconds_t kBetweenTriesUs = 50'000;

std::string ReadOwner(int fd) {
  char owner[32] = {};
  const ssize_t length = ::pread(fd, owner, sizeof(owner) - 1, 0);
  const std::string process = length > 0 ? owner : "";
  return process.substr(0, process.find_first_not_of("0123456789"));
}

bool TryLock(int fd) {
  for (int i = 1; ::flock(fd, LOCK_EX | LOCK_NB) != 0; ++i) {
    if (errno != EWOULDBLOCK || i == kLockTries) return false;
    ::usleep(kBetweenTriesUs);
  }
  return true;
}

}  // namespace

std::vector<fs::path> Workspace::TexturedMeshFiles() const {
  std::vector<fs::path> paths;
  for (const char* ending : {".obj", ".mtl", ".glb", ".ply", "_0.png"}) {
    paths.emplace_back(TexturedMesh().string() + ending);
  }
  return paths;
}

std::vector<StandardStage> StandardStages(const Workspace& w) {
  return {
      {"feature_extractor", {w.Database()}, "motion_splitter"},
      {"motion_splitter", {w.ObjectDatabase(), w.StaticDatabase(), w.SplitLabels()}, "motion_splitter"},
      {"object_mapper", {}, "turntable_mapper"},
      {"background_mapper", {}, "turntable_mapper"},
      {"turntable_mapper", {w.ObjectModel(), w.Turntable()}, "turntable_mapper"},
      {"gaussian_trainer", {w.PointCloud()}, "gaussian_trainer"},
      {"image_undistorter", {w.DenseImages(), w.DenseModel()}, "gaussian_renderer"},
      {"gaussian_renderer", {w.Masks(), w.DepthMaps()}, "gaussian_renderer"},
      {"tsdf_mesher", {w.TsdfMesh()}, "tsdf_mesher"},
      {"mesh_texturer", w.TexturedMeshFiles(), "mesh_texturer"},
      {"report", {w.ReportHtml(), w.ReportJson()}, "report"},
  };
}

std::vector<std::pair<fs::path, std::string>> WorkspaceContents(const Workspace& w) {
  return {
      {w.Images(), "photos"},
      {w.Imported(), "photos and frames that came in other formats, as PNG"},
      {w.Database(), "features and matches"},
      {w.ObjectDatabase(), "two-view geometries of the rotating part"},
      {w.StaticDatabase(), "two-view geometries of the background"},
      {w.SplitLabels(), "case, stations and every keypoint's label"},
      {w.SplitOverlays(), "photos with their keypoints coloured by label"},
      {w.ObjectModel(), "sparse model of the rotating part"},
      {w.StaticModel(), "sparse model of the background"},
      {w.Turntable(), "axis, stations and angles"},
      {w.ScaleReport(), "the scene's scale in metres, and each length's residual"},
      {w.Plan(), "the plan: what runs, what is left out and why"},
      {w.Checkpoints(), "training checkpoints"},
      {w.PointCloud(), "Gaussians"},
      {w.Masks(), "masks of the rotating part"},
      {w.DenseImages(), "undistorted photos"},
      {w.DenseModel(), "their sparse model"},
      {w.DepthMaps(), "depth maps"},
      {w.NormalMaps(), "normal maps"},
      {w.TsdfMesh(), "mesh from the depth maps"},
      {w.TexturedMesh().string() + ".glb", "mesh with the photos' colours, in one file"},
      {w.TexturedMesh().string() + ".obj", "the same for other programs"},
      {w.TexturedMesh().string() + ".mtl", "its material"},
      {w.TexturedMesh().string() + ".ply", "the same for other programs"},
      {w.TexturedMesh().string() + "_0.png", "its texture's first page"},
      {w.PoissonMesh(), "COLMAP's Poisson mesh"},
      {w.DelaunayMesh(), "COLMAP's Delaunay mesh"},
      {w.Log(), "log"},
      {w.MaskLog(), "the masks' log"},
      {w.MeshLog(), "the mesh's log"},
      {w.ScanRecord(), "command lines and times of the scanner's last run"},
      {w.ReportHtml(), "report: what the scan did and how good it is"},
      {w.ReportJson(), "the report's figures"},
  };
}

WorkspaceLock::WorkspaceLock(const Workspace& workspace, Reporter& reporter)
    : WorkspaceLock(workspace, workspace.LockFile(), reporter) {}

WorkspaceLock::WorkspaceLock(const Workspace& workspace, const fs::path& file, Reporter& reporter) {
  std::error_code ec;
  if (!fs::is_directory(workspace.root, ec)) {
    throw UserError(workspace.root, "no such folder", "Check --workspace_path, or create the folder");
  }
  RequireNoLinkOut(workspace.root, workspace.Own());
  CreateFolder(workspace.Own());
  const fs::path& path = file;
  // Programs that s2gs starts must not hold the lock after it ends: close-on-exec.
  fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (fd_ < 0 && (errno == EACCES || errno == EROFS || errno == EPERM)) {
    // A finished workspace may be read-only: what is done is still found to be done.
    const int error = errno;
    fd_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    errno = error;
  }
  if (fd_ < 0) {
    throw UserError(path, std::string("cannot be opened (") + std::strerror(errno) + ")",
                    "Check that you may write in the workspace");
  }
  if (TryLock(fd_)) {
    const std::string owner = std::to_string(::getpid()) + "\n";
    // For the other's message only: the lock holds without it.
    [[maybe_unused]] const bool is_written =
        ::ftruncate(fd_, 0) == 0 && ::write(fd_, owner.data(), owner.size()) > 0;
    return;
  }
  const int error = errno;
  if (error != EWOULDBLOCK) {
    reporter.Warn(path.string() + ": cannot be locked (" + std::strerror(error) +
                  "). Do not run s2gs twice at once in this workspace");
    return;
  }
  const std::string process = ReadOwner(fd_);
  ::close(std::exchange(fd_, -1));
  throw UserError(
      workspace.root,
      "another s2gs" + (process.empty() ? "" : " (process " + process + ")") + " works in this workspace",
      "Wait until it is done, or stop it; what it finished is kept");
}

WorkspaceLock::~WorkspaceLock() {
  if (fd_ >= 0) ::close(fd_);
}

std::optional<std::string> OwnerOfLock(const fs::path& file) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return std::nullopt;
  std::optional<std::string> owner;
  if (::flock(fd, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK) owner = ReadOwner(fd);
  ::close(fd);
  return owner;
}

void RemoveStaleWorkspaceTemporaries(const Workspace& workspace) {
  RemoveStaleTemporaries(workspace.root);
  std::error_code ec;
  fs::recursive_directory_iterator entry(workspace.root, fs::directory_options::skip_permission_denied, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    std::error_code is_folder_ec;
    if (entry->is_symlink(is_folder_ec) || !entry->is_directory(is_folder_ec)) continue;
    if (entry.depth() == 0 && entry->path().filename() == workspace.Images().filename()) {
      entry.disable_recursion_pending();
    } else {
      RemoveStaleTemporaries(entry->path());
    }
  }
}

}  // namespace s2gs
