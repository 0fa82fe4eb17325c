#include "plugin/outputs/unscaled_scene.h"

#include <cstdint>
#include <nlohmann/json.hpp>
#include <ostream>
#include <system_error>

#include "plugin/stage/json_file.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scale/scale_model.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxBytes = uint64_t{1} << 30;
constexpr const char* kMapper = "turntable_mapper.json";

std::string Read(const fs::path& path) {
  return ReadWholeFile(path, kMaxBytes, "Run `s2gs turntable_mapper` first");
}

void Write(const fs::path& path, const std::string& text) {
  WriteFileAtomically(path, [&](std::ostream& out) { out << text; });
}

}  // namespace

UnscaledScene::UnscaledScene(const Workspace& workspace)
    : workspace_(workspace), copy_(workspace.SplitLabels().parent_path() / "unscaled") {
  const std::string turntable = Read(workspace.Turntable());
  std::error_code ec;
  if (!fs::exists(copy_ / "turntable.json", ec) || Read(copy_ / "turntable.json") != turntable) {
    fs::remove_all(copy_, ec);
    CreateFolder(copy_);
    WriteColmapModel(copy_ / "0", ReadColmapModel(workspace.ObjectModel()), ColmapFormat::kBinary);
    if (fs::exists(workspace.StaticModel(), ec)) {
      WriteColmapModel(copy_ / "static", ReadColmapModel(workspace.StaticModel()), ColmapFormat::kBinary);
    }
    if (Exists(workspace.TurntableMapper())) Write(copy_ / kMapper, Read(workspace.TurntableMapper()));
    Write(copy_ / "turntable.json", turntable);
  }
  object = ReadColmapModel(copy_ / "0");
  if (fs::exists(copy_ / "static", ec)) background = ReadColmapModel(copy_ / "static");
  table = ReadTurntableFile(copy_ / "turntable.json");
}

void UnscaledScene::WriteInMetres(double metres_per_unit) {
  ScaleModel(metres_per_unit, &object);
  WriteColmapModel(workspace_.ObjectModel(), object, ColmapFormat::kBinary);
  if (!background.images.empty()) {
    ScaleModel(metres_per_unit, &background);
    WriteColmapModel(workspace_.StaticModel(), background, ColmapFormat::kBinary);
  }
  nlohmann::json mapper = ReadJsonFile(copy_ / kMapper);
  const nlohmann::json::json_pointer axis_point("/sigma/axis_point");
  if (mapper.is_object() && mapper.contains(axis_point) && mapper.at(axis_point).is_number()) {
    mapper.at(axis_point) = metres_per_unit * mapper.at(axis_point).get<double>();
    Write(workspace_.TurntableMapper(),
          mapper.dump(1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n");
  }
  ScaleTurntableToMetres(metres_per_unit, &table);
  WriteTurntableFile(workspace_.Turntable(), table);
  std::error_code ec;
  fs::remove_all(copy_, ec);
}

}  // namespace s2gs
