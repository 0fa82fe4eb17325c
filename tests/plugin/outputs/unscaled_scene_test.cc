#include "plugin/outputs/unscaled_scene.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

Workspace MakeWorkspace(const TemporaryFolder& folder) {
  const Workspace workspace{folder.path()};
  ColmapModel model;
  model.cameras[1] = {1, CameraModelId::kPinhole, 640, 480, {700, 700, 320, 240}};
  ColmapImage image;
  image.image_id = 1;
  image.camera_id = 1;
  image.name = "a.jpg";
  image.cam_from_world.translation = {1, 2, 3};
  model.images[1] = image;
  std::filesystem::create_directories(workspace.ObjectModel());
  WriteColmapModel(workspace.ObjectModel(), model, ColmapFormat::kBinary);
  TurntableFile table;
  table.num_stations = 1;
  table.images.push_back({"a.jpg", 0, 0, Rigid3()});
  WriteTurntableFile(workspace.Turntable(), table);
  WriteAll(workspace.TurntableMapper(), R"({"sigma": {"axis_point": 0.5, "pixel": 0.2}, "stations": 1})");
  return workspace;
}

nlohmann::json Mapper(const Workspace& workspace) {
  return nlohmann::json::parse(ReadAll(workspace.TurntableMapper()));
}

TEST(UnscaledScene, ScalesTheDeviationsOfLengthsToo) {
  const TemporaryFolder folder;
  const Workspace workspace = MakeWorkspace(folder);
  UnscaledScene(workspace).WriteInMetres(0.1);
  EXPECT_NEAR(Mapper(workspace)["sigma"]["axis_point"].get<double>(), 0.05, 1e-15);
  EXPECT_EQ(Mapper(workspace)["sigma"]["pixel"], 0.2);
  EXPECT_EQ(Mapper(workspace)["stations"], 1);
  EXPECT_EQ(ReadTurntableFile(workspace.Turntable()).units, LengthUnit::kMetre);
  const ColmapModel model = ReadColmapModel(workspace.ObjectModel());
  EXPECT_NEAR(model.images.at(1).cam_from_world.translation.z(), 0.3, 1e-12);
}

TEST(UnscaledScene, AKilledRunScalesNothingTwice) {
  const TemporaryFolder folder;
  const Workspace workspace = MakeWorkspace(folder);
  {
    // All but turntable.json, which is written last.
    const std::string turntable = ReadAll(workspace.Turntable());
    const UnscaledScene copied(workspace);
    const TemporaryFolder kept;
    std::filesystem::copy(folder / "split/unscaled", kept / "unscaled",
                          std::filesystem::copy_options::recursive);
    UnscaledScene(workspace).WriteInMetres(0.1);
    std::filesystem::copy(kept / "unscaled", folder / "split/unscaled",
                          std::filesystem::copy_options::recursive);
    WriteAll(workspace.Turntable(), turntable);
  }
  UnscaledScene(workspace).WriteInMetres(0.1);
  EXPECT_NEAR(Mapper(workspace)["sigma"]["axis_point"].get<double>(), 0.05, 1e-15);
  const ColmapModel model = ReadColmapModel(workspace.ObjectModel());
  EXPECT_NEAR(model.images.at(1).cam_from_world.translation.z(), 0.3, 1e-12);
}

TEST(UnscaledScene, NeedsNoRecordOfTheMapper) {
  const TemporaryFolder folder;
  const Workspace workspace = MakeWorkspace(folder);
  std::filesystem::remove(workspace.TurntableMapper());
  UnscaledScene(workspace).WriteInMetres(0.1);
  EXPECT_FALSE(std::filesystem::exists(workspace.TurntableMapper()));
  EXPECT_EQ(ReadTurntableFile(workspace.Turntable()).units, LengthUnit::kMetre);
}

}  // namespace
}  // namespace s2gs
