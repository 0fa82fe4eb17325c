// How often RegisterByAppearance is right: photos of a finished workspace are taken out, a part of them at a
// time, and placed again with their stations' cameras.
//   guided_bench WORKSPACE [PARTS]

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "plugin/stage/scan_input.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/relocalise/guided_registration.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

int main(int argc, char** argv) {
  using namespace s2gs;
  if (argc < 2) return 1;
  const Workspace workspace{argv[1]};
  const int parts = argc > 2 ? std::stoi(argv[2]) : 4;
  const ScanInput input = ReadScanInput(workspace);
  const ColmapDatabase database =
      ColmapDatabase::Open(workspace.ObjectDatabase(), ColmapDatabase::Access::kReadOnly);
  const ReadDescriptors read = [&](int image) {
    const DescriptorMatrix descriptors =
        database.ReadDescriptors(input.features.images[static_cast<size_t>(image)].image_id);
    return std::vector<uint8_t>(descriptors.data(), descriptors.data() + descriptors.size());
  };
  AlignedScene whole;
  whole.object = ReadColmapModel(workspace.ObjectModel());
  const TurntableFile file = ReadTurntableFile(workspace.Turntable());
  whole.scene.axis = file.axis;
  for (const auto& [id, camera] : whole.object.cameras) whole.scene.cameras.push_back(camera);
  std::map<std::string, const ColmapImage*> image_of_name;
  for (const auto& [id, image] : whole.object.images) image_of_name[image.name] = &image;
  for (const TurntableImage& image : file.images) {
    View view;
    view.name = image.name;
    view.camera_id = image_of_name.at(image.name)->camera_id;
    view.station = image.station;
    view.angle_deg = image.angle_deg;
    view.world_from_object = image.world_from_object;
    view.cam_from_world = image_of_name.at(image.name)->cam_from_world * image.world_from_object.Inverse();
    whole.scene.views.push_back(view);
  }
  size_t num_out = 0;
  size_t num_right = 0;
  size_t num_wrong = 0;
  std::vector<double> errors;
  for (int part = 0; part < parts; ++part) {
    AlignedScene aligned = whole;
    std::map<std::string, double> truth;
    std::vector<std::string> names;
    for (size_t v = 0; v < whole.scene.views.size(); ++v) {
      if (static_cast<int>(v) % parts != part) continue;
      names.push_back(whole.scene.views[v].name);
      truth[names.back()] = whole.scene.views[v].angle_deg;
    }
    RemoveImages(names, &aligned.object);
    std::vector<View>& views = aligned.scene.views;
    views.erase(std::remove_if(views.begin(), views.end(),
                               [&](const View& view) { return truth.count(view.name) > 0; }),
                views.end());
    num_out += names.size();
    Reporter reporter;
    std::vector<ImagePairMatches> pairs;
    RegisterByAppearance(input.features, read, {}, reporter, &aligned, &pairs);
    for (const View& view : views) {
      const auto found = truth.find(view.name);
      if (found == truth.end()) continue;
      const double degree = kPi / 180;
      const double error = std::abs(WrapAngle((view.angle_deg - found->second) * degree)) / degree;
      errors.push_back(error);
      (error < 1 ? num_right : num_wrong) += 1;
      if (error >= 1) std::printf("%s is %.2f degrees off\n", view.name.c_str(), error);
    }
  }
  std::sort(errors.begin(), errors.end());
  std::printf("%s: %zu taken out, %zu placed within 1 degree, %zu wrong; median %.4f, largest %.4f degrees\n",
              argv[1], num_out, num_right, num_wrong, errors.empty() ? 0.0 : errors[errors.size() / 2],
              errors.empty() ? 0.0 : errors.back());
  return 0;
}
