#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mesh/refine/photo_consistency.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Lays the points of a patch on the mesh itself. A plane through a curved surface lies in front of it beside
/// the middle, so that photos agree best where the plane stands too deep: by a quarter of a pixel where the
/// radius is 8 pixels, and half a pixel at an edge.
class SurfaceRelief {
 public:
  /// \param mesh  must stay, with the same triangles; its vertices may move.
  explicit SurfaceRelief(const TriangleMesh& mesh);

  /// What a thread needs for itself.
  class Scratch {
   public:
    Scratch();

   private:
    friend class SurfaceRelief;
    struct Slot {
      uint32_t vertex = 0;
      uint32_t place = 0;
      uint32_t turn = 0;  // of the patch that filled the slot
    };
    struct Place {
      uint32_t vertex;
      bool is_open;  // a triangle of it reaches into the patch
      bool is_done;  // its triangles are drawn
      Eigen::Vector3f x;
    };
    void Clear();
    std::vector<Slot> slots_;
    std::vector<Place> places_;     // vertices met so far
    std::vector<uint32_t> opened_;  // of these, in this order
    uint32_t turn_ = 0;
  };

  /// Gives the patch's points the heights of the surface around the vertex. Left out are points where the
  /// surface ends, overhangs, or faces away from one of the patch's photos.
  /// \param patch  around the vertex, with its photos and laid flat.
  void Lay(uint32_t vertex, Scratch* scratch, SurfacePatch* patch) const;

 private:
  const TriangleMesh& mesh_;
  // Triangles of each vertex.
  std::vector<size_t> starts_;
  std::vector<uint32_t> triangles_;
};

}  // namespace s2gs
