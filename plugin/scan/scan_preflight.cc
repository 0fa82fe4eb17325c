#include "plugin/scan/scan_preflight.h"

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <functional>
#include <limits>
#include <map>
#include <set>
#include <system_error>

#include "plugin/colmap/colmap_process.h"
#include "plugin/photos/video_frames.h"
#include "plugin/shared_options/backend_choice.h"
#include "plugin/stage/angle_list.h"
#include "plugin/stage/fingerprint.h"
#include "plugin/stage/stage.h"
#include "s2gs/image/photo_folder.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/train_options.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/machine_share.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMinPhotos = 3;
constexpr int kOldestColmapMajor = 3;
constexpr int kOldestColmapMinor = 8;
// A photo has about one feature on so many pixels, until there are as many as may be (measured: 57 at 400
// px).
constexpr int64_t kPixelsPerFeature = 80;
constexpr int64_t kBytesPerFeature = 4 * 6 + 128;  // of a keypoint and its descriptor
constexpr int64_t kNumDatabases = 3;           // all features, those of the object, those of the background
constexpr int64_t kMapBytesPerPixel = 4 + 12;  // of a depth map and a normal map
// While a photo is decoded and looked for features in: RGB, grey, and a scale space of floats of a quarter of
// it.
constexpr int64_t kDecodedBytesPerPixel = 3 + 1 + 3;
constexpr int64_t kTrainingBytesPerPixel = 4;  // RGB and a mask
constexpr int kSmallestTrainingSize = 240;     // of all presets

std::string InMegabytes(int64_t bytes) {
  return bytes < 10'000'000'000 ? fmt::format("{} MB", (bytes + 999'999) / 1'000'000)
                                : fmt::format("{:.1f} GB", static_cast<double>(bytes) * 1e-9);
}

// The folder itself or the nearest one above it that exists.
fs::path NearestFolder(const fs::path& folder) {
  std::error_code ec;
  fs::path path = fs::absolute(folder, ec).lexically_normal();
  while (!fs::exists(path, ec) && path.has_parent_path() && path != path.parent_path())
    path = path.parent_path();
  return path;
}

class Preflight {
 public:
  Preflight(const ScanRequest& request, Reporter& reporter) : request_(request), reporter_(reporter) {}

  ScanCheck Run() {
    CheckOptions();
    CheckStagesDone();
    CheckPlaces();
    if (request_.is_video) {
      CheckVideo();
    } else {
      photos_ = request_.import ? PhotosOf(*request_.import) : InspectPhotoFolder(request_.image_path);
      CheckPhotos();
    }
    if (!request_.mask_path.empty()) CheckMasks();
    if (!request_.angles_path.empty()) CheckAngles();
    CheckSpace();
    CheckColmap();
    return std::move(check_);
  }

 private:
  void Fault(const std::string& fault) { check_.faults.push_back(fault); }
  void OptionFault(const OptionCheck& fault) {
    if (fault) {
      check_.option_faults.push_back("--" + fault->field + " " + fault->value + " violates " + fault->bound);
    }
  }

  // Under this command's own names, then what the others would say.
  void CheckOptions() {
    TrainOptions train;
    train.num_iterations = request_.num_iterations.value_or(train.num_iterations);
    OptionFault(train.Check());
    TrainingSceneOptions size;
    size.max_image_size = request_.max_image_size.value_or(size.max_image_size);
    OptionFault(size.Check());
    TrainingSceneOptions held_out;
    held_out.test_every = request_.test_every;
    OptionFault(held_out.Check());
    if (request_.use_gpu != "auto" && request_.use_gpu != "0" && request_.use_gpu != "1") {
      check_.option_faults.push_back("--use_gpu " + request_.use_gpu + " is none of auto, 0, 1");
    }
    if (check_.option_faults.empty()) {
      for (const auto& [name, arguments] : request_.steps) CheckStep(name, arguments);
    }
    if (request_.use_gpu == "1") {
      BackendChoice choice;
      choice.use_gpu = UseGpu::kYes;
      const std::string problem = GpuProblem(choice);
      if (!problem.empty())
        Fault("--use_gpu 1: no GPU can be used: " + problem + ". Give --use_gpu 0 or auto");
    }
  }

  void CheckStep(const std::string& name, const std::vector<std::string>& arguments) {
    const std::vector<Command>& commands = AllCommands();
    const auto command =
        std::find_if(commands.begin(), commands.end(), [&](const Command& c) { return c.name == name; });
    if (command == commands.end()) {
      Fault("this program was built without " + name + " (S2GS_SFM=OFF): use one that was built with it");
      return;
    }
    try {
      CheckArguments(*command, arguments);
    } catch (const CommandLineError& error) {
      check_.option_faults.push_back(name + ": " + error.what());
    }
  }

  void CheckStagesDone() {
    Reporter silent;
    std::error_code ec;
    if (!fs::is_directory(request_.workspace.root, ec)) return;
    for (const StageStatus& status : CheckStages(request_.workspace, silent)) {
      const bool is_there = status.state == StageState::kDone ||
                            (status.name == "feature_extractor" && status.state == StageState::kForeign);
      if (is_there) done_.insert(status.name);
    }
  }
  bool IsDone(const std::string& stage) const { return done_.count(stage) > 0; }
  bool HasPoses() const { return IsDone("motion_splitter") && IsDone("turntable_mapper"); }
  bool IsAllDone() const {
    return IsDone("feature_extractor") && HasPoses() && (!request_.trains || IsDone("gaussian_trainer")) &&
           (!request_.meshes || (IsDone("gaussian_renderer") && IsDone("tsdf_mesher"))) &&
           (!request_.textures || IsDone("mesh_texturer"));
  }

  void CheckPlaces() {
    const Workspace& w = request_.workspace;
    const fs::path images = ResolvedPath(request_.image_path);
    const fs::path root = ResolvedPath(w.root);
    if (IsWithin(root, images)) {
      Fault(w.root.string() + ": the workspace lies in the photos' folder " + request_.image_path.string() +
            ", and its own pictures would be taken for photos. Give another --workspace_path");
    }
    const std::vector<fs::path> own = {w.Masks(), w.root / "dense", w.root / "split", w.root / "sparse",
                                       w.Own()};
    for (const fs::path& folder : own) {
      if (IsWithin(images, ResolvedPath(folder))) {
        Fault(request_.image_path.string() + ": the photos lie where results are written (" +
              folder.string() + "). Keep them in a folder of their own");
      }
    }
    if (IsAllDone()) return;  // nothing will be written
    CheckLinks();
    std::vector<fs::path> written = own;
    written.push_back(w.root);
    for (const fs::path& folder : written) {
      const fs::path nearest = NearestFolder(folder);
      std::error_code ec;
      if (!fs::is_directory(nearest, ec)) {
        Fault(nearest.string() + ": is no folder, but " + folder.string() +
              " must be one. Remove or rename it");
      } else if (folder == w.root || fs::exists(folder, ec)) {
        if (::access(nearest.c_str(), W_OK | X_OK) != 0) {
          Fault(nearest.string() +
                ": nothing can be written there. Check its permissions, or choose another "
                "--workspace_path");
        }
      }
    }
  }

  // Of the places where this scan will write.
  void CheckLinks() {
    const Workspace& w = request_.workspace;
    std::vector<fs::path> places = {w.Own(), w.Masks(), w.root / "dense", w.ReportHtml(), w.ReportJson()};
    if (!HasPoses()) places.insert(places.end(), {w.root / "split", w.root / "sparse", w.Turntable()});
    if (!IsDone("feature_extractor")) places.push_back(w.Database());
    for (const fs::path& place : places) {
      const std::optional<fs::path> link = FindLinkOut(w.root, place);
      if (!link) continue;
      Fault(link->string() +
            ": is a symbolic link out of the workspace or to another file, through which nothing is written. "
            "Remove it, or replace it by a folder or a copy");
    }
  }

  // As they will be after the import.
  static PhotoFolder PhotosOf(const ImportPlan& import) {
    PhotoFolder folder;
    folder.faults = import.faults;
    folder.notes = import.notes;
    for (const PhotoToImport& photo : import.photos) {
      folder.photos.push_back(photo.file);
      folder.photos.back().name = photo.name;
    }
    return folder;
  }

  void CheckVideo() {
    if (IsDone("photo_importer")) return;
    try {
      FindFfmpeg(request_.ffmpeg_path);
    } catch (const UserError& error) {
      Fault(error.what());
    }
  }

  void CheckPhotos() {
    check_.faults.insert(check_.faults.end(), photos_.faults.begin(), photos_.faults.end());
    check_.notes = photos_.notes;
    const size_t num = photos_.photos.size();
    const std::string folder = request_.image_path.string();
    const std::string advice = "a scan needs at least " + std::to_string(kMinPhotos) +
                               ", and a whole turn of the table in steps of 20 degrees has 18";
    if (num == 0 && !photos_.faults.empty()) return;
    if (num == 0) {
      Fault(folder + ": has no photos (.jpg, .jpeg, .png). Check --image_path");
    } else if (num < kMinPhotos) {
      Fault(fmt::format("{}: has {} photo{} only: {}", folder, num, num == 1 ? "" : "s", advice));
    } else {
      CheckCopies(folder, advice);
    }
    CheckMarkedPhotos();
  }

  void CheckMarkedPhotos() {
    for (const auto& [name, option] : request_.marked_photos) {
      const bool is_known =
          std::any_of(photos_.photos.begin(), photos_.photos.end(),
                      [&photo = name](const PhotoFile& known) { return known.name == photo; });
      if (is_known) continue;
      Fault(fmt::format("{}: has no photo \"{}\", in which --{} states a place{}",
                        request_.image_path.string(), name, option,
                        request_.import
                            ? ". Photos that have to be converted are called as what they become: "
                              "NAME.png"
                            : ". Name it as its path below that folder"));
    }
  }

  // Files of one length are compared.
  void CheckCopies(const std::string& folder, const std::string& advice) {
    std::map<uint64_t, std::vector<const PhotoFile*>> by_length;
    for (const PhotoFile& photo : photos_.photos) by_length[photo.num_bytes].push_back(&photo);
    size_t num_copies = 0;
    std::string example;
    for (const auto& [length, photos] : by_length) {
      if (photos.size() < 2 || length == 0) continue;
      std::map<std::string, const PhotoFile*> by_content;
      for (const PhotoFile* photo : photos) {
        if (reporter_.StopRequested()) throw Interrupted();
        std::string content;
        try {
          content = TakeFingerprint(photo->path, reporter_).content;
        } catch (const UserError&) {
          continue;  // named among the faults
        }
        const auto [other, is_new] = by_content.emplace(content, photo);
        if (is_new) continue;
        if (num_copies++ == 0) example = photo->name + " is " + other->second->name;
      }
    }
    if (num_copies == 0) return;
    const size_t num_different = photos_.photos.size() - num_copies;
    if (num_different < kMinPhotos) {
      Fault(fmt::format("{}: its {} photos are copies of {} (for example {}): {}", folder,
                        photos_.photos.size(), num_different == 1 ? "a single one" : "two", example, advice));
    } else {
      check_.warnings.push_back(
          fmt::format("{} of the photos are copies of others: {}, for example", num_copies, example));
    }
  }

  void CheckMasks() {
    const fs::path& folder = request_.mask_path;
    std::error_code ec;
    if (!fs::is_directory(folder, ec)) {
      Fault(folder.string() + ": there is no such folder of masks. Check --mask_path");
      return;
    }
    if (fs::equivalent(folder, request_.image_path, ec) || folder == request_.workspace.Imported()) {
      CheckAlpha();
      return;
    }
    if (request_.import) {
      for (const PhotoToImport& photo : request_.import->photos) {
        if (!photo.is_mirrored) continue;
        Fault(photo.file.name +
              ": is mirrored by its EXIF, and its mask would not fit. Turn the photo and its mask "
              "upright, or leave --mask_path out");
        return;
      }
    }
    size_t num_missing = 0;
    std::string example;
    for (const PhotoFile& photo : photos_.photos) {
      const fs::path path = FindMask(folder, photo.name);
      if (path.empty()) {
        if (num_missing++ == 0) example = photo.name;
        continue;
      }
      try {
        const ImageSize size = ReadImageSize(path);
        if (photo.size.width == 0 || (size.width == photo.size.width && size.height == photo.size.height))
          continue;
        Fault(fmt::format("{}: is {} x {} pixels, its photo {} x {}. Make masks of the photos' size",
                          path.string(), size.width, size.height, photo.size.width, photo.size.height));
      } catch (const UserError& error) {
        Fault(error.what());
      }
    }
    if (num_missing > 0) {
      Fault(fmt::format(
          "{}: {} of {} photos have no mask there, {} for example. {}; give one for each photo, or leave "
          "--mask_path out",
          folder.string(), num_missing, photos_.photos.size(), example, kMaskNames));
    }
  }

  // Frames of a video have no names yet.
  void CheckAngles() {
    try {
      const std::map<std::string, double> listed = ReadAngleList(request_.angles_path);
      std::vector<std::string> names;
      for (const PhotoFile& photo : photos_.photos) names.push_back(photo.name);
      std::vector<std::string> unknown;
      if (!names.empty()) AnglesOfPhotos(listed, names, request_.angles_path, &unknown);
      if (unknown.empty()) return;
      check_.warnings.push_back(fmt::format("{}: {} names are none of the photos': {}, for example",
                                            request_.angles_path.string(), unknown.size(), unknown[0]));
    } catch (const UserError& error) {
      Fault(error.what());
    }
  }

  // Photos that were cut out are their own masks.
  void CheckAlpha() {
    for (const PhotoFile& photo : photos_.photos) {
      const bool may_have =
          photo.is_png ? photo.png.has_alpha : photo.size.width > 0 && IsForeign(photo.name);
      if (may_have) continue;
      Fault(request_.mask_path.string() + ": holds the photos, and " + photo.name +
            " has no alpha channel to be its mask. Keep masks in a folder of their own");
      return;
    }
  }
  bool IsForeign(const std::string& name) const {
    if (!request_.import) return false;
    const std::vector<PhotoToImport>& photos = request_.import->photos;
    return std::any_of(photos.begin(), photos.end(),
                       [&](const PhotoToImport& photo) { return photo.name == name && photo.is_foreign; });
  }

  // Estimates from below: what is refused here would have failed.
  void CheckSpace() {
    int64_t features = 0;
    int64_t maps = 0;
    int64_t training = 0;
    int64_t largest = 0;
    const double side = request_.max_image_size.value_or(kSmallestTrainingSize);
    for (const PhotoFile& photo : photos_.photos) {
      const int64_t pixels = int64_t{photo.size.width} * photo.size.height;
      if (pixels == 0) continue;
      features += kBytesPerFeature * std::min<int64_t>(request_.max_num_features, pixels / kPixelsPerFeature);
      maps += kMapBytesPerPixel * pixels + static_cast<int64_t>(photo.num_bytes);
      const double scale = std::min(1.0, side / std::max(photo.size.width, photo.size.height));
      training += kTrainingBytesPerPixel * static_cast<int64_t>(scale * scale * static_cast<double>(pixels));
      largest = std::max(largest, pixels);
    }
    int64_t needed = 0;
    if (!IsDone("feature_extractor")) needed += kNumDatabases * features;
    if (request_.meshes && !IsDone("gaussian_renderer")) needed += maps;
    const fs::path place = NearestFolder(request_.workspace.root);
    std::error_code ec;
    const fs::space_info space = fs::space(place, ec);
    if (!ec && needed > 0 && static_cast<uint64_t>(needed) > space.available) {
      Fault(
          fmt::format("{}: about {} are needed on that disk, {} are free. Free some space, choose another "
                      "--workspace_path, or give smaller photos",
                      request_.workspace.root.string(), InMegabytes(needed),
                      InMegabytes(static_cast<int64_t>(space.available))));
    }
    rlimit limit = {};
    if (!IsDone("feature_extractor") && ::getrlimit(RLIMIT_FSIZE, &limit) == 0 &&
        limit.rlim_cur != RLIM_INFINITY && limit.rlim_cur < static_cast<uint64_t>(features)) {
      Fault(fmt::format(
          "files may have {} at most here (`ulimit -f`), the photos' features need about {}. Raise the "
          "limit: ulimit -f unlimited",
          InMegabytes(static_cast<int64_t>(limit.rlim_cur)), InMegabytes(features)));
    }
    const uint64_t available = AvailableMemoryBytes();
    if (available == std::numeric_limits<uint64_t>::max()) return;
    const auto memory = static_cast<int64_t>(available);
    if (!IsDone("feature_extractor") && kDecodedBytesPerPixel * largest > memory) {
      Fault(
          fmt::format("the largest photo needs about {} of memory while it is read, {} are free. Close other "
                      "programs, or give smaller photos",
                      InMegabytes(kDecodedBytesPerPixel * largest), InMegabytes(memory)));
    }
    if (request_.trains && !IsDone("gaussian_trainer") && training > memory) {
      Fault(fmt::format(
          "the photos need about {} of memory in training, {} are free. Give a smaller --max_image_size",
          InMegabytes(training), InMegabytes(memory)));
    }
  }

  void CheckColmap() {
    if (IsDone("feature_extractor") && HasPoses() && request_.colmap_path.empty()) return;
    try {
      const std::string version = ColmapProgram::Find(request_.colmap_path, reporter_).version();
      int major = 0;
      int minor = 0;
      const char* end = version.data() + version.size();
      const char* point = std::from_chars(version.data(), end, major).ptr;
      if (point != end) std::from_chars(point + 1, end, minor);
      if (std::pair(major, minor) < std::pair(kOldestColmapMajor, kOldestColmapMinor)) {
        Fault("colmap is of version " + version +
              ", and 3.8 or newer is needed. Install one, or name it with "
              "--colmap_path");
      }
    } catch (const UserError& error) {
      Fault(error.what());
    }
  }

  const ScanRequest& request_;
  Reporter& reporter_;
  ScanCheck check_;
  std::set<std::string> done_;
  PhotoFolder photos_;
};

}  // namespace

ScanCheck CheckScan(const ScanRequest& request, Reporter& reporter) {
  return Preflight(request, reporter).Run();
}

void RequireSoundScan(const ScanRequest& request, Reporter& reporter) {
  const ScanCheck check = CheckScan(request, reporter);
  for (const std::string& note : check.notes) reporter.Info(note);
  for (const std::string& warning : check.warnings) reporter.Warn(warning);
  std::vector<std::string> all = check.option_faults;
  all.insert(all.end(), check.faults.begin(), check.faults.end());
  if (all.empty()) return;
  const std::string message = all.size() == 1 ? all[0] : ListFaults("the scan cannot begin", all);
  if (check.faults.empty()) throw CommandLineError(message);
  throw UserError(message);
}

}  // namespace s2gs
