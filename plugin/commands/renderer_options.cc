#include "plugin/commands/renderer_options.h"

namespace s2gs {
namespace {

const EnumNames<DepthKind> kDepthNames = {{"median", DepthKind::kMedian}, {"expected", DepthKind::kExpected}};
const EnumNames<MapsOf> kMapsOfNames = {{"object", MapsOf::kObject}, {"all", MapsOf::kAll}};
const EnumNames<PlainTable> kPlainTableNames = {{"object", PlainTable::kObject},
                                                {"background", PlainTable::kBackground}};

}  // namespace

void AddRendererOptions(Options* options, RendererArguments* a) {
  options->Add("workspace_path", &a->workspace_path, "the workspace, with sparse/0 and s2gs/point_cloud.ply")
      .Required();
  options->Add("image_path", &a->image_path, "the photos; empty: images in the workspace");
  options->Add("model_path", &a->model_path, "the Gaussians; empty: s2gs/point_cloud.ply in the workspace");
  options->Add("output_path", &a->output_path,
               "folder for images that are no part of a workspace; empty: s2gs/renders in the workspace");
  options->Add("image_list", &a->image_list,
               "file with the names of the photos to render, one a line; empty: all");
  options->Add("masks", &a->masks, "masks of the rotating part: masks/NAME.png in the workspace, 255 inside");
  options->Add(
      "stereo", &a->stereo,
      "depth maps, normal maps and silhouettes of the rotating part alone: dense/0/stereo/*/"
      "NAME.geometric.bin and dense/0/masks, for tsdf_mesher and colmap stereo_fusion; makes dense/0 "
      "when there is none");
  options->AddEnum("depth", &a->depth, kDepthNames, "which depth goes into the maps");
  options->AddEnum("maps_of", &a->maps_of, kMapsOfNames,
                   "what the maps show: the rotating part, or the background too");
  options->Add("undistort_always", &a->undistort_always,
               "resample photos for dense/0 even where they have no distortion and could be copied");
  AddBackendOptions(options, &a->backend);
  options->Section("Table", "whose a table's top is, and what the model has built over it", [&] {
    options->AddEnum(
        "plain_table", &a->plain_table, kPlainTableNames,
        "whose, in masks, a table is that is so plain that it may turn or stand still by the photos, "
        "where its top ends in a circle about the axis");
    options->Add(
        "cut_at_table", &a->cut_at_table,
        "of photos of one station, leave out what rotates by the model and lies below the table's top "
        "or beyond its rim, does not "
        "stand on it and is not the side of a body: plain ground");
    options->Add(
        "clear_plain_top", &a->clear_plain_top,
        "leave out what rotates by the model over a table's top where photos see the top itself: its "
        "texture, or where it is plain its colour in the light or, where things seldom look like one, in a "
        "shadow on it");
    options->Add("table_seen", &a->table_seen,
                 "draw a table's top into depth and normal maps where photos show it, by its colour or its "
                 "texture, whatever the model has before it; dense/0/table_seen says where");
  });
  options->Section("Pictures", "images and a film to look at", [&] {
    options->Add("color", &a->color, "the scene as the photo should look: color/NAME.png");
    options->Add("foreground", &a->foreground, "the map of p, 255 is 1: foreground/NAME.png");
    options->Add("pictures", &a->pictures,
                 "depth and normals of the rotating part to look at: depth/NAME.png, normal/NAME.png");
    options->Add("comparison", &a->comparison,
                 "photo, rendering, error and mask side by side: comparison/NAME.png");
    options->Add("overview", &a->overview,
                 "such a comparison of four photos to look at: s2gs/comparison.jpg in the workspace");
    options->Add(
        "num_frames", &a->num_frames,
        "frames of a film of one turn of the table, seen by one photo's camera: frames/NNNN.png; 0: none");
    options->Add("frame_station", &a->frame_station,
                 "the station whose first photo lends its camera to the film");
  });
}

}  // namespace s2gs
