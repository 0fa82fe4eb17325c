#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <memory>
#include <vector>

#include "mesh/light/shaded_normals.h"
#include "mesh/refine/mesh_refinement.h"
#include "mesh/refine/offset_field.h"
#include "mesh/refine/photo_consistency.h"
#include "mesh/refine/vertex_visibility.h"
#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Two photos agree by chance too often.
constexpr int kLeastPhotosCompared = 3;
/// Steeper views say neither where a surface is nor that it is there.
constexpr float kMinSeenCosine = 0.2F;

/// The photos that show a mesh, cut to it and as fine as its triangles need.
class RefinementPhotos {
 public:
  /// \param reporter  must stay.
  RefinementPhotos(int num_threads, Reporter& reporter) : num_threads_(num_threads), reporter_(reporter) {}

  /// Throws what the source throws, Interrupted, and UserError where they do not fit into memory.
  void Load(const RefinementPhotoSource& source, const TriangleMesh& mesh, double max_memory_gib);

  size_t size() const { return photos_.size(); }
  /// Whether it is known of any where it shows the plane.
  bool ShowPlane() const;

  /// Which vertices stand before the plane that photos see: at least two photos see the vertex, on this
  /// mesh, where they show the plane behind it.
  std::vector<uint8_t> FindSeenThrough(const TriangleMesh& mesh,
                                       const std::vector<VertexFlags>& visible) const;

  /// For each photo, which vertices it sees. Throws Interrupted.
  std::vector<VertexFlags> FindVisible(const TriangleMesh& mesh, const VisibilityRule& rule) const;

  /// Of the triangles that are not to be kept, those that close the mesh: most of the photos that see the
  /// front of one, and at least `least_photos`, would look past the rest of the mesh there, or at its inside,
  /// and not at another surface. \param keep  by triangle. Throws Interrupted.
  std::vector<bool> FindClosing(const TriangleMesh& mesh, const std::vector<bool>& keep,
                                int least_photos) const;

  /// Edge of a pixel at a place, of the photo that is nearest to it, in the mesh's unit.
  float FinestPixel(const Eigen::Vector3f& x_in_object) const;

  /// What photos of one exposure show of the vertices that they see, by vertex, and the photos' turns. \param
  /// visible  of FindVisible.
  std::vector<ShadedSample> SampleShading(const TriangleMesh& mesh, const VertexGraph& graph,
                                          const std::vector<VertexFlags>& visible) const;
  const std::vector<Eigen::Matrix3d>& world_from_object() const { return turns_; }

  /// The surface at a vertex with the photos that are compared there, not laid out yet.
  /// \param visible  of FindVisible.
  SurfacePatch PatchAt(const TriangleMesh& mesh, size_t vertex, const std::vector<VertexFlags>& visible,
                       int max_views) const;

 private:
  const int num_threads_;
  Reporter& reporter_;
  std::vector<ObjectView> views_;  // as the photos are: cut and shrunk
  std::vector<std::unique_ptr<PhotoPyramid>> photos_;
  std::vector<Eigen::Matrix3d> turns_;
  std::vector<float> gains_;  // of the photos' exposures
  struct PlaneSight {
    Image8 seen;
    ObjectView view;  // of its size
  };
  std::vector<PlaneSight> sights_;  // by photo
  double seen_height_ = 0;
};

}  // namespace s2gs
