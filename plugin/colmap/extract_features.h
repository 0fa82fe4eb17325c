#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "plugin/cli/options.h"
#include "plugin/colmap/colmap_process.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Options of `colmap feature_extractor`, by COLMAP's names; those left empty stay COLMAP's own.
struct SiftExtractionOptions {
  /// COLMAP's 8,192 keeps the largest features, and those lie on the background: a small object in front of a
  /// rich background would lose its own.
  int max_num_features = 16384;
  std::optional<int> max_image_size;
  std::optional<int> first_octave;
  std::optional<double> peak_threshold;
  std::optional<double> edge_threshold;
  std::optional<bool> estimate_affine_shape;
  std::optional<bool> domain_size_pooling;
  std::optional<int> num_threads;  ///< empty: as many as there are cores to use and as fit into memory.
  std::optional<bool> use_gpu;  ///< empty: where COLMAP was built with CUDA, and the processor if that fails.

  OptionCheck Check() const;
};

/// The cameras that photos start with.
struct ImageReaderOptions {
  std::string camera_model = "SIMPLE_RADIAL";
  /// Of that model, in pixels and COLMAP's order with commas: "f,cx,cy,k" of SIMPLE_RADIAL. Like what EXIF
  /// says, poses start with them and may move them by a few percent. Empty: by EXIF, or a guess.
  std::string camera_params;

  OptionCheck Check() const;
};

struct FeatureExtraction {
  std::filesystem::path image_path;
  std::filesystem::path database_path;
  ImageReaderOptions reader;
  SiftExtractionOptions sift;
};

/// Declares --SiftExtraction.* and --ImageReader.*.
void AddFeatureExtractionOptions(Options& options, FeatureExtraction* extraction);

/// How photos share cameras.
enum class CameraSharing {
  kOne,        ///< all photos have one size and one focal length by EXIF, as far as it is known.
  kPerFolder,  ///< those of each folder have.
  kPerLook,    ///< those of one folder, size and focal length do.
};

struct PhotoSet {
  std::vector<std::filesystem::path> photos;  ///< sorted.
  std::vector<std::string> notes;             ///< what is left alone, for the user.
  bool has_other_files = false;               ///< beside the photos.
  CameraSharing sharing = CameraSharing::kOne;
  /// For kPerLook: names, relative to the folder, of the photos of each camera.
  std::vector<std::vector<std::string>> cameras;
  ImageSize largest;  ///< the photo of the most pixels.
  /// Focal lengths by EXIF [px], by name, of photos whose EXIF COLMAP does not read (PNG) or misreads, for
  /// they were cut.
  std::map<std::string, double> focal_px;
};

/// Reads all photos of a folder and its folders, so that damage is known before hours of work. Throws
/// UserError when there are no photos (JPEG, PNG), and with the names of those that cannot be used or read.
PhotoSet ReadPhotoSet(const std::filesystem::path& image_path);

/// Memory in which COLMAP looks for the features of one photo, of which each of its threads has one [bytes].
uint64_t FeatureMemoryBytes(const ImageSize& photo, const SiftExtractionOptions& options);

/// Whether a database needs features: it is missing or has no images.
bool NeedsFeatures(const std::filesystem::path& database_path);

/// Runs `colmap feature_extractor` on all photos. The database appears, or is replaced, when all is done.
void ExtractFeatures(const FeatureExtraction& extraction, ColmapProgram* colmap, Reporter& reporter);

/// The stage "feature_extractor": extracts when the database has no features yet, or has those of an earlier
/// run of this stage with other photos or options. A database from elsewhere is left as it is.
/// \param options  those that change the result.
void RunFeatureStage(const FeatureExtraction& extraction, const std::filesystem::path& colmap_path,
                     const std::map<std::string, std::string>& options, const Workspace& workspace,
                     StageRunner* runner, Reporter& reporter);

}  // namespace s2gs
