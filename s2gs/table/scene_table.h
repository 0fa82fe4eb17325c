#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_error.h"
#include "s2gs/image/image_file.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/table/layers_over_top.h"
#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"
#include "s2gs/table/textured_top.h"
#include "s2gs/table_rim.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

struct SceneTableOptions {
  /// Whose a table is that may turn or stand still by the photos: the rotating part's, or the background's.
  bool plain_is_object = true;
  bool clear_plain_top = true;  ///< take out what photos refute over a top, by its colour or texture.
  bool draw_seen = true;        ///< learn where photos show the top itself.
  bool cut_around = true;       ///< take out what stands still around the table.
};

/// Takes rotating Gaussians out of the model and says so. \param gaussians  in ascending order.
void LeaveOut(const std::vector<uint32_t>& gaussians, const char* which, Backend* backend,
              Reporter& reporter);

/// The table of a scene as photos show it or, where they do not, as the model has it.
class SceneTable {
 public:
  /// Photos tell the rim to a fraction of a pixel; where they do not, the model may. What photos refute about
  /// a table that they show is taken out of the model. Photos that cannot be read are warned about, and then
  /// only the model is asked. \param load  a photo without distortion, of its view's size. \param shape  of
  /// the rotating part, to which a table is added that counts as its; its side goes where photos show where
  /// the table's ends.
  static SceneTable Find(const TrainingScene& scene, const LoadPhoto& load, const SceneTableOptions& options,
                         std::optional<RotatingShape>* shape, Backend* backend, Reporter& reporter);

  /// Adds a table of the rotating part to a mask of what rotates.
  void AddToMask(const PinholeView& view, PixelMask* mask) const;
  /// Draws it into depths and normals, unless photos show its shape and not that it is a plane.
  void DrawIntoMaps(const PinholeView& view, RenderedView* drawn) const;
  /// Where a photo of the scene shows the top itself, of its StationView's size; without pixels where nothing
  /// is known of it. \param load  as Find's.
  Image8 Seen(const ScenePhoto& photo, const LoadPhoto& load) const;
  bool IsTopSeen() const;

  // What was found.
  std::optional<TableRim> rim;
  std::optional<TableCircle> circle;     ///< by the photos.
  std::optional<double> textured_share;  /// of the top; by the photos.
  bool is_plane = false;                 ///< by its texture, the photos show that it is.
  size_t num_around = 0;                 ///< Gaussians that were taken out.
  size_t num_over_top = 0;

 private:
  // A plain top, and what photos tell by showing it.
  struct SeenTop {
    PlainTop top;
    TopEvidence evidence;
    // By photo and pixel, of what hides shadows on the top behind it; 0 where nothing does.
    std::map<std::string, std::vector<float>> hiding_depths;
  };
  void ClearPlainTop(const TrainingScene& scene, const std::vector<StationPhotos>& stations,
                     const std::vector<Eigen::Vector3d>& of_things, bool draw_seen, Backend* backend,
                     Reporter& reporter);

  std::optional<RotatingRegion> in_masks_;  // where it is known whose it is
  std::optional<RotatingRegion> in_maps_;   // the same, where its shape is not left to splats
  std::optional<SeenTop> seen_top_;
  std::optional<TexturedTop> known_texture_;
};

}  // namespace s2gs
