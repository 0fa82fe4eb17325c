#include "tests/plugin/commands/split_fixture.h"

#include <cstdint>

namespace s2gs {

void WriteSplitFixture(const std::filesystem::path& path, const std::vector<std::string>& names,
                       const std::function<void(ColmapDatabase&)>& more) {
  ColmapDatabase::WriteAtomically(path, [&](ColmapDatabase& database) {
    Camera camera;
    camera.camera_id = 1;
    camera.model = CameraModelId::kSimplePinhole;
    camera.width = kFixtureWidth;
    camera.height = kFixtureHeight;
    camera.params = {20, 8, 6};
    database.WriteCamera({camera, true});
    KeypointMatrix keypoints(2, 2);
    keypoints << 1, 2, 3, 4;
    for (const std::string& name : names) {
      DatabaseImage row;
      row.name = name;
      row.camera_id = 1;
      const uint32_t id = database.WriteImage(row);
      database.WriteKeypoints(id, keypoints);
      DescriptorMatrix descriptors(2, 128);
      descriptors.row(0).setConstant(static_cast<uint8_t>(id));
      descriptors.row(1).setConstant(static_cast<uint8_t>(id + 1));
      database.WriteDescriptors(id, descriptors);
    }
    if (more) more(database);
  });
}

}  // namespace s2gs
