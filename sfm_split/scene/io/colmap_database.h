#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/features.h"
#include "sfm_split/scene/io/colmap_schema.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

class SqliteConnection;

struct DatabaseCamera {
  Camera camera;
  bool has_prior_focal_length = false;  ///< the focal length comes from EXIF or the user, not from a guess.
};

struct DatabaseImage {
  uint32_t image_id = 0;
  std::string name;  ///< path relative to the image folder.
  uint32_t camera_id = 0;
  /// Columns of COLMAP 3.8 alone (newer versions have a table of their own for priors): the prior rotation
  /// (w, x, y, z) as stored, and the prior position, which is latitude, longitude and altitude from EXIF.
  std::optional<Eigen::Vector4d> prior_qvec;
  std::optional<Eigen::Vector3d> prior_tvec;
};

/// n x 2: x, y [px]; n x 4: x, y, scale, orientation [rad]; n x 6: x, y and the affine shape a11, a12, a21,
/// a22.
using KeypointMatrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// SIFT descriptors, one a row.
using DescriptorMatrix = Eigen::Matrix<uint8_t, Eigen::Dynamic, 128, Eigen::RowMajor>;

/// COLMAP's TwoViewGeometry::ConfigurationType, by its numbers in the database.
enum class TwoViewConfig : int {
  kUndefined = 0,
  kDegenerate = 1,
  kCalibrated = 2,
  kUncalibrated = 3,
  kPlanar = 4,
  kPanoramic = 5,
  kPlanarOrPanoramic = 6,
  kWatermark = 7,
  kMultiple = 8,
  kCalibratedRig = 9,
};

/// How two images see the same rigid body. Matrices that are zero, and poses that are zero or the identity,
/// are how COLMAP says that it has none.
struct TwoViewGeometry {
  TwoViewConfig config = TwoViewConfig::kUndefined;
  FeatureMatches inlier_matches;
  std::optional<Eigen::Matrix3d> F;  ///< x2^T F x1 = 0 in pixels.
  std::optional<Eigen::Matrix3d> E;  ///< the same for rays with z = 1.
  std::optional<Eigen::Matrix3d> H;  ///< x2 ~ H x1 in pixels.
  std::optional<Rigid3> cam2_from_cam1;

  /// The same geometry with the two images in the other order. An H that has no inverse is dropped.
  TwoViewGeometry Swapped() const;
};

struct TwoViewGeometryOfPair {
  uint32_t image_id1 = 0;
  uint32_t image_id2 = 0;
  TwoViewGeometry geometry;
};

/// COLMAP's key of an unordered pair of different images.
uint64_t PairIdFromImageIds(uint32_t image_id1, uint32_t image_id2);

/// A COLMAP database, of the versions 3.8 to 4.2 (tables that the older of them lack are left alone).
/// Opening never migrates. Content is checked: blobs against their row and column counts, ids, and the
/// keypoint rows that matches refer to. All faults of the file are thrown as UserError with its path.
///
/// Matches come in the order of the image ids that they are asked for by, whatever the order they are stored
/// in. Not for use by several threads at once.
class ColmapDatabase {
 public:
  enum class Access {
    kReadOnly,   ///< leaves every file as it is, works in folders that cannot be written. Throws when another
                 ///< program changes a database in WAL mode while it is being read.
    kReadWrite,  ///< waits `busy_timeout_ms` for other programs' locks.
  };

  static constexpr int kDefaultBusyTimeoutMs = 5000;  ///< a transaction of COLMAP's takes less

  static ColmapDatabase Open(const std::filesystem::path& path, Access access,
                             int busy_timeout_ms = kDefaultBusyTimeoutMs);

  /// An empty database with the schema of COLMAP 3.8, which newer versions migrate when they open it.
  /// Throws when the file exists. See WriteAtomically() for files that must never be seen half-written.
  static ColmapDatabase Create(const std::filesystem::path& path);

  /// Creates a database, lets `fill` write into it, and gives it its name only when `fill` is through.
  static void WriteAtomically(const std::filesystem::path& path,
                              const std::function<void(ColmapDatabase&)>& fill);

  /// Copies a database together with what its write-ahead log still holds, lets `edit` change the copy, and
  /// then gives it its name, replacing the file that has it. `from` stays as it is.
  /// Throws Interrupted when the reporter asks to stop.
  static void SafeCopy(const std::filesystem::path& from, const std::filesystem::path& to, Reporter& reporter,
                       const std::function<void(ColmapDatabase&)>& edit = nullptr);

  ColmapDatabase(ColmapDatabase&& other) noexcept;
  ColmapDatabase& operator=(ColmapDatabase&& other) noexcept;
  ColmapDatabase(const ColmapDatabase&) = delete;
  ColmapDatabase& operator=(const ColmapDatabase&) = delete;
  ~ColmapDatabase();

  /// Closes the file and leaves none beside it; the object is of no more use. Throws what the destructor
  /// hides.
  void Close();

  const std::filesystem::path& path() const;
  /// COLMAP's version that wrote the schema: 3800 is 3.8, 4020100 is 4.2.1.
  int64_t schema_version() const { return schema_.version; }

  /// Runs `change` as one transaction: all of it is written, or, when it throws, nothing. Many times faster
  /// than single writes, each of which waits for the disk. Not nested.
  void InTransaction(const std::function<void()>& change);

  /// By ascending id.
  std::vector<DatabaseCamera> ReadCameras() const;
  std::vector<DatabaseImage> ReadImages() const;

  /// Add a row. An id of 0 leaves the choice to the database.
  /// From COLMAP 3.12's schema on, a camera comes with a rig and an image with a frame of its own.
  /// \return the id.
  uint32_t WriteCamera(const DatabaseCamera& camera);
  uint32_t WriteImage(const DatabaseImage& image);

  /// 0 rows when the image has none.
  KeypointMatrix ReadKeypoints(uint32_t image_id) const;
  DescriptorMatrix ReadDescriptors(uint32_t image_id) const;
  uint64_t NumKeypoints(uint32_t image_id) const;
  /// Replace what the image has.
  void WriteKeypoints(uint32_t image_id, const KeypointMatrix& keypoints);
  void WriteDescriptors(uint32_t image_id, const DescriptorMatrix& descriptors);

  /// Whether a pair was matched, with however many matches.
  bool HasMatches(uint32_t image_id1, uint32_t image_id2) const;
  /// Empty when the pair has none.
  FeatureMatches ReadMatches(uint32_t image_id1, uint32_t image_id2) const;
  /// Replaces what the pair has.
  void WriteMatches(uint32_t image_id1, uint32_t image_id2, const FeatureMatches& matches);
  /// Every pair that was matched, with image_id1 < image_id2, by ascending pair id; one pair is in memory at
  /// a time. `visit` may read from the database, not write to it.
  void ForEachMatches(const std::function<void(uint32_t image_id1, uint32_t image_id2,
                                               const FeatureMatches& matches)>& visit) const;

  /// Numbers the images from 1 in the order of their names, and their keypoints and descriptors with them.
  /// COLMAP's extractor numbers them as its threads happen to finish, which what follows would depend on.
  /// Only for databases without matches. Databases of COLMAP 3.12 and newer, which know frames, stay as they
  /// are.
  void NumberImagesByName();

  /// Gives the images of each group one camera: that of its first image whose focal length is known, or of
  /// its first image. Cameras that no image has any more are deleted. Databases of COLMAP 3.12 and newer,
  /// whose cameras belong to rigs, stay as they are. \param groups  names of images; those that the database
  /// does not have are passed over.
  void ShareCameras(const std::vector<std::vector<std::string>>& groups);

  /// Gives the cameras of these images the focal length that is known of them [px], on both axes, and marks
  /// it as known. Of images that share a camera the first by name counts; images that the database does not
  /// have are passed over, and so are camera models without a focal length.
  void SetFocalPriors(const std::map<std::string, double>& focal_px);

  /// Nothing when the pair has none.
  std::optional<TwoViewGeometry> ReadTwoViewGeometry(uint32_t image_id1, uint32_t image_id2) const;
  /// Replaces what the pair has.
  void WriteTwoViewGeometry(uint32_t image_id1, uint32_t image_id2, const TwoViewGeometry& geometry);
  /// As ForEachMatches().
  void ForEachTwoViewGeometry(const std::function<void(uint32_t image_id1, uint32_t image_id2,
                                                       const TwoViewGeometry& geometry)>& visit) const;
  /// Removes the geometries of all pairs and writes these, in one transaction.
  void ReplaceTwoViewGeometries(const std::vector<TwoViewGeometryOfPair>& geometries);

 private:
  explicit ColmapDatabase(std::unique_ptr<SqliteConnection> connection);
  void CheckMatches(const FeatureMatches& matches, uint32_t image_id1, uint32_t image_id2) const;

  std::unique_ptr<SqliteConnection> connection_;
  ColmapSchema schema_;
};

}  // namespace s2gs
