#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Moves a mesh's vertices along their normals to where the photos that see them agree best, and drops what
/// hardly any photo sees. Splats' depths lie a little behind a surface that the photos fix to a fraction of a
/// pixel; and where no photo looks, splats are whatever hides behind the rest.
///
/// Each vertex carries a small plane, which is projected into photos from different sides at several offsets;
/// the correlation of what they show there, averaged with the vertex's neighbours, has its peak at the
/// surface (Furukawa and Ponce, "Accurate, dense, and robust multiview stereopsis", 2010, score their patches
/// so). The peaks, weighted by their sharpness, become a smooth field of offsets on the mesh. From coarse to
/// fine in three passes; in the last the patches have the mesh's own relief. Where photos contradict each
/// other after these, the surface is carved (surface_carving.h), and the last pass comes again. Where the
/// table turns, small forms then follow their shading (normal_integration.h). What photos
/// refute at the end is dropped (refuted_surface.h), and what no photo sees behind it.

struct MeshRefinementOptions {
  bool enabled = true;
  int num_views = 8;               ///< photos in which a vertex is compared.
  double max_view_angle_deg = 60;  ///< between a vertex's normal and the rays to these photos.
  double smoothness = 0.1;         ///< of the offsets over the mesh; larger trusts photos less.
  /// Where fewer vertices have a clear peak in the first pass none moves [%]: the others would follow few,
  /// which may be chance or gloss. 0: they move.
  double least_clear_pct = 20;
  /// A triangle stays when so many of the photos, and at least two, see each of its corners [%]; one with
  /// fewer than 30 photos; 0: all stay. So does one without which as many would see no surface there.
  double min_seen_pct = 3;
  bool shading = true;       ///< small forms by how light that stands still shades them (shaded_normals.h).
  bool carve = true;         ///< open hollows that photos contradict (surface_carving.h).
  bool drop_refuted = true;  ///< parts where hardly two photos show the same (refuted_surface.h).
  /// A little above the top of a table across z, what is higher stands on it in parts that are judged as
  /// wholes, too (parts_borne_out.h). Nothing: there is no table.
  std::optional<double> table_height;
  bool drop_seen_through = true;  ///< parts where photos show the plane behind them (LoadPlaneSeen).
  double max_memory_gib = 4;      ///< photos are shrunk until they fit.
  int num_threads = 0;            ///< 0: one for each core.

  OptionCheck Check() const;
};

/// Grey photos without distortion, that need not be in memory.
class RefinementPhotoSource {
 public:
  RefinementPhotoSource() = default;
  RefinementPhotoSource(const RefinementPhotoSource&) = delete;
  RefinementPhotoSource& operator=(const RefinementPhotoSource&) = delete;
  virtual ~RefinementPhotoSource() = default;

  virtual int size() const = 0;
  virtual const ObjectView& Camera(int index) const = 0;
  /// One channel, of the camera's size. Called from several threads at once. May throw.
  virtual Image8 Load(int index) const = 0;
  /// Of the same part of the image plane, of any size: 255 where the photo shows the level plane at
  /// SeenHeight() itself, so that nothing stands before it. Without pixels where nothing is known.
  virtual Image8 LoadPlaneSeen(int /*index*/) const { return {}; }
  virtual double SeenHeight() const { return 0; }  ///< along z.
  /// How the table stands in the photo: light that stands still falls on the object from elsewhere.
  virtual Eigen::Matrix3d WorldFromObject(int /*index*/) const { return Eigen::Matrix3d::Identity(); }
  /// By how much the photo is brighter than others of the same light.
  virtual double Gain(int /*index*/) const { return 1; }
};

/// How well the photos agree on the mesh at one moment of its refinement.
struct RefinementMoment {
  double seconds = 0;       ///< since the refinement began.
  double disagreement = 0;  ///< 1 - mean correlation of photos over vertices spread evenly; at full size.
};

struct MeshRefinementSummary {
  int num_photos = 0;                 ///< that show the mesh.
  int64_t num_vertices = 0;           ///< after what nobody sees is gone.
  int64_t num_clear = 0;              ///< of these, with a clear peak in the first pass, which decides.
  int64_t num_accepted = 0;           ///< and in the last; 0 where none moves.
  int64_t num_carved = 0;             ///< of the vertices, taken from the front of a hollow into it.
  int64_t num_unseen_triangles = 0;   ///< dropped.
  int64_t num_refuted_triangles = 0;  ///< dropped.
  int64_t num_seen_through = 0;       ///< triangles dropped.
  double mean_offset_px = 0;          ///< how far vertices moved outwards in all passes, in pixels there.
  double rms_offset_px = 0;
  double seconds = 0;
  std::vector<RefinementMoment>
      course;                   ///< before the first pass and after each; what no photo sees is gone.
  int64_t num_shaded = 0;       ///< vertices that shading moved.
  double rms_shaded_px = 0;     ///< how far.
  bool is_lit = false;          ///< a light that stands still explains how places change from photo to photo.
  double error_even_light = 0;  ///< of photos that no light was fitted to, under even light [grey values].
  double error_turn_light = 0;  ///< the same under light that stands still.
  bool has_moved = false;       ///< enough vertices had a clear peak in some pass.
};

/// Fewer photos of the mesh than this do not refine it.
constexpr int kMinRefinementPhotos = 4;

/// Nothing happens with fewer than kMinRefinementPhotos photos of the mesh. The result is bit-identical for
/// any number of threads. Throws what the source throws, and Interrupted. \param mesh  in the object's frame;
/// its normals are computed again, its colours stay.
MeshRefinementSummary RefineMesh(const RefinementPhotoSource& photos, const MeshRefinementOptions& options,
                                 Reporter& reporter, TriangleMesh* mesh);

}  // namespace s2gs
