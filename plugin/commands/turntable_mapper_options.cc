#include "plugin/commands/turntable_mapper_options.h"

namespace s2gs {

void AddTurntableMapperOptions(Options& options, TurntableMapperSettings* settings) {
  options.Add("workspace_path", &settings->workspace_path, "the workspace, with split/ from motion_splitter")
      .Required();
  options.Add("image_path", &settings->image_path, "the photos; empty: images in the workspace");
  options.Add("colmap_path", &settings->colmap_path,
              "the colmap executable or its folder; empty: searched for on PATH");
  options.AddEnum(
      "path", &settings->placement.path,
      {{"auto", PlacementPath::kAuto},
       {"free_sfm", PlacementPath::kFreeSfm},
       {"circular_motion", PlacementPath::kCircular},
       {"single_axis", PlacementPath::kSingleAxis}},
      "how the object is placed: by free SfM, by the circular motion that each station's matches show, by "
      "the "
      "table's axis and angles from the background's cameras, or by whichever explains the matches best");
  options.Add("max_mapper_attempts", &settings->max_attempts,
              "runs of `colmap mapper` for one body, each more tolerant");
  options.Add("mapper_options", &settings->mapper_options,
              "options for `colmap mapper` in its own spelling, like Mapper.ba_global_max_refinements=2");
  options.Add("angles_path", &settings->angles_path,
              "table angles that are known: a CSV file of NAME,ANGLE in degrees, or the folder of OpenScan's "
              "scan or project; compared with the photos' and, where these bear them out, a prior of the "
              "adjustment; empty: none");
  options
      .Add("step_deg", &settings->step_deg,
           "the table's step from photo to photo by name, within each station; as --angles_path; 0: unknown")
      .Unit("degrees");
  options.Add(
      "adjust_to_photos", &settings->adjust_to_photos,
      "find each point's places by patches in all photos that it faces, and adjust everything to them "
      "where patches that were held back bear it out");
  options.Add(
      "circle_first", &settings->circle_first,
      "take the poses to which circular motion leads by itself where every test calls them good, and do "
      "without `colmap mapper` of the object; with --path auto");
  auto joint =
      options.Group("Joint", &settings->placement.joint,
                    "the joint adjustment of cameras, table and points: what it moves, when it ends");
  joint.AddEnum("model", &JointOptions::model,
                {{"auto", JointModel::kAuto},
                 {"shared_stations", JointModel::kSharedStations},
                 {"free_cameras", JointModel::kFreeCameras},
                 {"wobbling_table", JointModel::kWobblingTable},
                 {"free_object", JointModel::kFreeObject}},
                "what the poses share");
  joint.Add("refine_focal_length", &JointOptions::refine_focal_length, "adjust the focal lengths");
  joint.Add("refine_principal_point", &JointOptions::refine_principal_point, "adjust the principal points");
  joint.Add("refine_extra_params", &JointOptions::refine_extra_params, "adjust the distortion");
  joint.Add("max_iterations", &JointOptions::max_iterations, "of Levenberg-Marquardt in a round");
  joint.Add("function_tolerance", &JointOptions::function_tolerance, "relative decrease at which it stops");
  joint.Add(
      "num_threads", &JointOptions::num_threads,
      "0: all cores; results depend on it only beyond a thousand camera-side parameters, where 0 is one");
}

}  // namespace s2gs
