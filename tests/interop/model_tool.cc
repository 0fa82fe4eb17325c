// Reads a COLMAP model and prints it or writes it again, for the tests that compare with COLMAP itself.
//   model_tool poses FOLDER             image name, then the 12 numbers of [R|t] of cam_from_world, one image
//   a line model_tool binary|text FROM TO      reads FROM, writes TO model_tool example FOLDER writes the
//   tests' example model model_tool example_rigs FOLDER      the same with rigs and frames

#include <cstdio>
#include <exception>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"
#include "tests/sfm_split/scene/io/colmap_model_example.h"

namespace {

using s2gs::ColmapFormat;

void PrintPoses(const s2gs::ColmapModel& model) {
  for (const auto& [id, image] : model.images) {
    std::printf("%s", image.name.c_str());
    const Eigen::Matrix4d matrix = image.cam_from_world.Matrix();
    for (int row = 0; row < 3; ++row) {
      for (int col = 0; col < 4; ++col) std::printf("\t%.17g", matrix(row, col));
    }
    std::printf("\n");
  }
}

int Run(int argc, char** argv) {
  const std::string command = argc > 1 ? argv[1] : "";
  if (command == "poses" && argc == 3) {
    PrintPoses(s2gs::ReadColmapModel(argv[2]));
  } else if (command == "binary" && argc == 4) {
    s2gs::WriteColmapModel(argv[3], s2gs::ReadColmapModel(argv[2]), ColmapFormat::kBinary);
  } else if (command == "text" && argc == 4) {
    s2gs::WriteColmapModel(argv[3], s2gs::ReadColmapModel(argv[2]), ColmapFormat::kText);
  } else if (command == "example" && argc == 3) {
    s2gs::WriteColmapModel(argv[2], s2gs::ExampleModel(), ColmapFormat::kBinary);
  } else if (command == "example_rigs" && argc == 3) {
    s2gs::WriteColmapModel(argv[2], s2gs::ExampleModelWithRigs(), ColmapFormat::kBinary);
  } else {
    std::fprintf(stderr, "usage: see the top of model_tool.cc\n");
    return 2;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return Run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
