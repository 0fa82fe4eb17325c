#include "plugin/colmap/extract_features.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <system_error>
#include <utility>
#include <vector>

#include "plugin/cli/option_value.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/image_file.h"
#include "s2gs/image/photo_folder.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/machine_share.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kStageName = "feature_extractor";

constexpr size_t kFewPhotos = 8;
// COLMAP's, where max_image_size and first_octave are left to it.
constexpr int kColmapImageSize = 3200;
constexpr int kColmapFirstOctave = -1;
// A scale space's first octave has six Gaussians, five differences and two gradients of five of them, in
// floats; measured with COLMAP 3.8: 69 bytes a pixel of that octave, 67 at the photo's own size, 59 for
// affine features.
constexpr double kScaleSpaceBytesPerPixel = 72;
constexpr double kDecodedBytesPerPixel = 4;  // RGB and grey

// With less space left than this, a database that lacks photos is one that the disk had no room for.
constexpr uint64_t kMinFreeBytes = uint64_t{16} << 20;

struct Look {
  int width = 0;
  int height = 0;
  std::optional<ExifTags> lens;  // where EXIF says something of it
};

// Photos without EXIF go with any.
bool MayShare(const Look& a, const Look& b) {
  if (a.width != b.width || a.height != b.height) return false;
  return !a.lens || !b.lens || a.lens->HasLensOf(*b.lens);
}

bool HaveOneLook(const std::vector<Look>& looks) {
  const auto with_lens =
      std::find_if(looks.begin(), looks.end(), [](const Look& look) { return look.lens.has_value(); });
  const Look& reference = with_lens == looks.end() ? looks.front() : *with_lens;
  return std::all_of(looks.begin(), looks.end(), [&](const Look& look) { return MayShare(reference, look); });
}

// Strictly, so that groups do not depend on their order.
bool IsSameLook(const Look& a, const Look& b) {
  if (a.width != b.width || a.height != b.height || a.lens.has_value() != b.lens.has_value()) return false;
  return !a.lens || a.lens->HasLensOf(*b.lens);
}

int64_t NumPixels(const ImageSize& size) { return int64_t{size.width} * size.height; }

std::vector<Look> ReadAppearance(const fs::path& image_path, const std::vector<fs::path>& photos) {
  std::vector<Look> looks(photos.size());
  std::vector<std::string> problems(photos.size());
  ParallelFor(static_cast<int64_t>(photos.size()), 0, [&](int64_t i) {
    try {
      const Image8 image = ReadImage(photos[i], 1);
      looks[i] = {image.width, image.height, ReadExif(photos[i])};
      if (looks[i].lens && !looks[i].lens->SaysOfLens()) looks[i].lens.reset();
    } catch (const UserError& error) {
      problems[i] = error.what();
    }
  });
  problems.erase(std::remove(problems.begin(), problems.end(), ""), problems.end());
  if (problems.empty()) return looks;
  throw UserError(ListFaults(image_path.string() + ": " + std::to_string(problems.size()) + " of " +
                                 std::to_string(photos.size()) + " photos cannot be read",
                             problems));
}

template <typename T>
void AddIfGiven(const char* name, const std::optional<T>& value, std::vector<ColmapOption>* options) {
  if (value) options->push_back({std::string("SiftExtraction.") + name, FormatValue(*value)});
}

// A database of ours that is removed with its logs and list of photos when all is done, or nothing came of
// it.
struct DatabaseRemover {
  explicit DatabaseRemover(fs::path database) : path(std::move(database)) {}
  DatabaseRemover(const DatabaseRemover&) = delete;
  DatabaseRemover& operator=(const DatabaseRemover&) = delete;
  ~DatabaseRemover() {
    std::error_code ec;
    for (const char* suffix : {"", "-wal", "-shm", ".txt"}) fs::remove(path.string() + suffix, ec);
  }

  const fs::path path;
};

void WritePhotoList(const fs::path& path, const std::vector<fs::path>& photos, const fs::path& image_path) {
  std::vector<std::string> names;
  names.reserve(photos.size());
  for (const fs::path& photo : photos) names.push_back(photo.lexically_relative(image_path).generic_string());
  std::sort(names.begin(), names.end());
  WriteFileAtomically(path, [&](std::ostream& stream) {
    for (const std::string& name : names) stream << name << '\n';
  });
}

size_t NumImages(const fs::path& database_path) {
  return ColmapDatabase::Open(database_path, ColmapDatabase::Access::kReadOnly).ReadImages().size();
}

void RunExtractor(const FeatureExtraction& extraction, const fs::path& database, const PhotoSet& set,
                  bool use_gpu, const fs::path& photo_list, ColmapProgram* colmap, Reporter& reporter) {
  std::error_code ec;
  for (const char* suffix : {"", "-wal", "-shm"}) fs::remove(database.string() + suffix, ec);
  const SiftExtractionOptions& sift = extraction.sift;
  std::vector<ColmapOption> options = {
      {"database_path", database.string()},
      {"image_path", extraction.image_path.string()},
      {"ImageReader.camera_model", extraction.reader.camera_model},
      {"ImageReader.single_camera", set.sharing == CameraSharing::kOne ? "1" : "0"},
      {"ImageReader.single_camera_per_folder", set.sharing == CameraSharing::kPerFolder ? "1" : "0"},
      {"SiftExtraction.max_num_features", std::to_string(sift.max_num_features)},
      {"SiftExtraction.use_gpu", use_gpu ? "1" : "0"},
  };
  if (!extraction.reader.camera_params.empty())
    options.push_back({"ImageReader.camera_params", extraction.reader.camera_params});
  AddIfGiven("max_image_size", sift.max_image_size, &options);
  AddIfGiven("first_octave", sift.first_octave, &options);
  AddIfGiven("peak_threshold", sift.peak_threshold, &options);
  AddIfGiven("edge_threshold", sift.edge_threshold, &options);
  AddIfGiven("estimate_affine_shape", sift.estimate_affine_shape, &options);
  AddIfGiven("domain_size_pooling", sift.domain_size_pooling, &options);
  // By itself COLMAP takes a thread for each core of the machine, whatever the process may use.
  const int num_threads =
      sift.num_threads.value_or(ThreadsThatFit(FeatureMemoryBytes(set.largest, extraction.sift)));
  options.push_back({"SiftExtraction.num_threads", std::to_string(num_threads)});
  if (!photo_list.empty()) options.push_back({"image_list_path", photo_list.string(), /*is_required=*/false});
  colmap->Run({"feature_extractor", std::move(options), {{database}}}, reporter);
}

}  // namespace

OptionCheck ImageReaderOptions::Check() const {
  if (camera_params.empty()) return std::nullopt;
  std::vector<double> params;
  try {
    ParseValue(camera_params, &params);
  } catch (const BadValue&) {
    return OptionFault{"camera_params", camera_params, "numbers with commas between them"};
  }
  const CameraModelInfo* model = FindCameraModel(camera_model);
  if (model != nullptr && params.size() != model->NumParams()) {
    return OptionFault{
        "camera_params", camera_params,
        fmt::format("the {} parameters of {}: {}", model->NumParams(), camera_model, model->param_names)};
  }
  return std::nullopt;
}

OptionCheck SiftExtractionOptions::Check() const {
  if (max_num_features < 1) return OptionFault{"max_num_features", std::to_string(max_num_features), ">= 1"};
  return std::nullopt;
}

void AddFeatureExtractionOptions(Options& options, FeatureExtraction* extraction) {
  using Reader = ImageReaderOptions;
  auto reader = options.Group("ImageReader", &extraction->reader,
                              "the cameras that photos start with, as COLMAP names it");
  reader.Add("camera_model", &Reader::camera_model, "COLMAP's camera model");
  reader.Add("camera_params", &Reader::camera_params,
             "the lens where it is known: the model's parameters in pixels, with commas, f,cx,cy,k of "
             "SIMPLE_RADIAL; they are refined. Empty: by EXIF, or a guess");
  using Sift = SiftExtractionOptions;
  auto sift =
      options.Group("SiftExtraction", &extraction->sift, "features of the photos, as COLMAP names it");
  sift.Add("max_num_features", &Sift::max_num_features,
           "features kept of a photo; COLMAP's own 8192 keeps the largest, which lie on the background");
  sift.Add("max_image_size", &Sift::max_image_size,
           "longest side to which photos are reduced; empty: COLMAP's");
  sift.Add("first_octave", &Sift::first_octave, "-1 doubles the photo's size; empty: COLMAP's");
  sift.Add("peak_threshold", &Sift::peak_threshold, "least contrast of a feature; empty: COLMAP's");
  sift.Add("edge_threshold", &Sift::edge_threshold, "bound that keeps edges out; empty: COLMAP's");
  sift.Add("estimate_affine_shape", &Sift::estimate_affine_shape, "affine features; empty: COLMAP's");
  sift.Add("domain_size_pooling", &Sift::domain_size_pooling,
           "descriptors of several sizes; empty: COLMAP's");
  sift.Add("num_threads", &Sift::num_threads,
           "threads; empty: one for each core that may be used, or as many as fit into memory");
  sift.Add("use_gpu", &Sift::use_gpu, "extract on the GPU; empty: where COLMAP can");
}

PhotoSet ReadPhotoSet(const fs::path& image_path) {
  PhotoSet set;
  const PhotoFolder inspected = InspectPhotoFolder(image_path);
  if (!inspected.faults.empty()) {
    throw UserError(ListFaults(image_path.string() + ": these photos cannot be used", inspected.faults));
  }
  if (inspected.photos.empty()) {
    throw UserError(image_path, "has no photos (.jpg, .jpeg, .png)", "Check --image_path");
  }
  set.notes = inspected.notes;
  set.has_other_files = inspected.has_other_files;
  set.photos.reserve(inspected.photos.size());
  for (const PhotoFile& photo : inspected.photos) set.photos.push_back(photo.path);
  const std::vector<Look> looks = ReadAppearance(image_path, set.photos);
  for (size_t i = 0; i < looks.size(); ++i) {
    const ImageSize size{looks[i].width, looks[i].height};
    if (NumPixels(size) > NumPixels(set.largest)) set.largest = size;
    if (!looks[i].lens) continue;
    const bool is_png = inspected.photos[i].is_png;
    if (!is_png && !IsCut(*looks[i].lens, size)) continue;
    const std::optional<double> focal = FocalPixels(*looks[i].lens, size);
    if (focal) set.focal_px[inspected.photos[i].name] = *focal;
  }
  if (HaveOneLook(looks)) return set;
  std::map<fs::path, std::vector<size_t>> folders;
  for (size_t i = 0; i < set.photos.size(); ++i) folders[set.photos[i].parent_path()].push_back(i);
  set.sharing = CameraSharing::kPerFolder;
  for (const auto& [folder, members] : folders) {
    std::vector<std::vector<size_t>> groups;
    for (const size_t i : members) {
      const auto same = std::find_if(groups.begin(), groups.end(), [&](const std::vector<size_t>& group) {
        return IsSameLook(looks[group.front()], looks[i]);
      });
      if (same == groups.end()) {
        groups.push_back({i});
      } else {
        same->push_back(i);
      }
    }
    std::vector<Look> in_folder;
    in_folder.reserve(members.size());
    for (const size_t i : members) in_folder.push_back(looks[i]);
    if (!HaveOneLook(in_folder)) set.sharing = CameraSharing::kPerLook;
    for (const std::vector<size_t>& group : groups) {
      std::vector<std::string>& names = set.cameras.emplace_back();
      names.reserve(group.size());
      for (const size_t i : group) {
        names.push_back(set.photos[i].lexically_relative(image_path).generic_string());
      }
    }
  }
  if (set.sharing == CameraSharing::kPerFolder) set.cameras.clear();
  return set;
}

uint64_t FeatureMemoryBytes(const ImageSize& photo, const SiftExtractionOptions& options) {
  const auto num_pixels = static_cast<double>(NumPixels(photo));
  const double reduction =
      std::min(1.0, static_cast<double>(options.max_image_size.value_or(kColmapImageSize)) /
                        std::max({photo.width, photo.height, 1}));
  const double in_octave =
      num_pixels * reduction * reduction * std::pow(4.0, -options.first_octave.value_or(kColmapFirstOctave));
  return static_cast<uint64_t>(kScaleSpaceBytesPerPixel * in_octave + kDecodedBytesPerPixel * num_pixels);
}

bool NeedsFeatures(const fs::path& database_path) {
  std::error_code ec;
  return !fs::exists(database_path, ec) || fs::file_size(database_path, ec) == 0 ||
         NumImages(database_path) == 0;
}

void ExtractFeatures(const FeatureExtraction& extraction, ColmapProgram* colmap, Reporter& reporter) {
  const PhotoSet set = ReadPhotoSet(extraction.image_path);
  const size_t num_photos = set.photos.size();
  const std::string shared = set.sharing == CameraSharing::kOne ? "one camera for all photos"
                             : set.sharing == CameraSharing::kPerFolder
                                 ? "one camera for each folder"
                                 : std::to_string(set.cameras.size()) + " cameras, by size and EXIF";
  for (const std::string& note : set.notes) reporter.Info(note);
  reporter.Info("features of " + std::to_string(num_photos) + " photos by colmap " + colmap->version() +
                ", " + shared);
  if (num_photos < kFewPhotos) {
    reporter.Warn("only " + std::to_string(num_photos) +
                  " photos: a whole turn of the table in steps of 20 degrees has 18");
  }
  const DatabaseRemover unfinished{extraction.database_path.string() + ".extracting"};
  // COLMAP takes every file that it can read for a photo.
  const fs::path photo_list = set.has_other_files ? fs::path(unfinished.path.string() + ".txt") : fs::path();
  if (!photo_list.empty()) WritePhotoList(photo_list, set.photos, extraction.image_path);
  const bool use_gpu = extraction.sift.use_gpu.value_or(colmap->has_cuda());
  try {
    RunExtractor(extraction, unfinished.path, set, use_gpu, photo_list, colmap, reporter);
  } catch (const UserError& error) {
    if (!use_gpu || extraction.sift.use_gpu.has_value()) throw;
    reporter.Warn(std::string("feature extraction on the GPU failed, going on without: ") + error.what());
    RunExtractor(extraction, unfinished.path, set, /*use_gpu=*/false, photo_list, colmap, reporter);
  }
  const size_t num_images = NumImages(unfinished.path);
  if (num_images < num_photos) {
    std::error_code ec;
    const fs::space_info space = fs::space(unfinished.path, ec);
    if (!ec && space.available < kMinFreeBytes) {
      throw UserError(extraction.database_path, "cannot be written: the disk is full",
                      "Free some space on that disk and run the command again");
    }
  }
  if (num_images == 0) {
    throw UserError(extraction.image_path, "colmap found features in none of the photos",
                    "Look at its output with --log_level debug");
  }
  if (num_images < num_photos) {
    reporter.Warn("colmap read only " + std::to_string(num_images) + " of the " + std::to_string(num_photos) +
                  " photos");
  }
  if (extraction.database_path.has_parent_path()) CreateFolder(extraction.database_path.parent_path());
  std::error_code ec;
  // What is left of an older database's log must not be taken for the new one's.
  for (const char* suffix : {"-wal", "-shm"}) fs::remove(extraction.database_path.string() + suffix, ec);
  ColmapDatabase::SafeCopy(unfinished.path, extraction.database_path, reporter,
                           [&](ColmapDatabase& database) {
                             database.NumberImagesByName();
                             database.ShareCameras(set.cameras);
                             database.SetFocalPriors(set.focal_px);
                           });
}

void RunFeatureStage(const FeatureExtraction& extraction, const fs::path& colmap_path,
                     const std::map<std::string, std::string>& options, const Workspace& workspace,
                     StageRunner* runner, Reporter& reporter) {
  const bool is_ours = ReadStageStamp(workspace, kStageName, reporter).has_value();
  if (!is_ours && !NeedsFeatures(extraction.database_path)) {
    reporter.Info("features are those of " + extraction.database_path.string());
    return;
  }
  const Stage stage{kStageName, {extraction.image_path}, options, {extraction.database_path}, {}};
  runner->Run(stage, [&] {
    ColmapProgram colmap = ColmapProgram::Find(colmap_path, reporter);
    ExtractFeatures(extraction, &colmap, reporter);
  });
}

}  // namespace s2gs
