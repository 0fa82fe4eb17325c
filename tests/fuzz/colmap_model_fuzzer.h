#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <sstream>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/sfm_split/scene/io/colmap_model_example.h"

namespace s2gs {

/// Reads one file. What can be read must come back the same after writing it and reading it again.
template <typename Items>
void CheckRoundTrip(const std::string& content, ColmapFormat format,
                    Items (*read)(std::istream&, ColmapFormat, const std::filesystem::path&),
                    void (*write)(std::ostream&, ColmapFormat, const Items&)) {
  Items items;
  try {
    std::istringstream stream(content);
    items = read(stream, format, "fuzz");
  } catch (const UserError&) {
    return;
  }
  const std::string written = Bytes(write, format, items);
  std::istringstream stream(written);
  if (Bytes(write, format, read(stream, format, "fuzz")) != written) std::abort();
}

/// The first byte of the input chooses the file.
inline int FuzzColmapFile(const uint8_t* data, size_t size, ColmapFormat format) {
  if (size == 0) return 0;
  const std::string content(reinterpret_cast<const char*>(data) + 1, size - 1);
  switch (data[0] % 5) {
    case 0:
      CheckRoundTrip(content, format, &ReadColmapCameras, &WriteColmapCameras);
      break;
    case 1:
      CheckRoundTrip(content, format, &ReadColmapImages, &WriteColmapImages);
      break;
    case 2:
      CheckRoundTrip(content, format, &ReadColmapPoints3D, &WriteColmapPoints3D);
      break;
    case 3:
      CheckRoundTrip(content, format, &ReadColmapRigs, &WriteColmapRigs);
      break;
    default:
      CheckRoundTrip(content, format, &ReadColmapFrames, &WriteColmapFrames);
      break;
  }
  return 0;
}

inline std::vector<std::string> ColmapSeeds(ColmapFormat format) {
  const ColmapModel model = ExampleModelWithRigs();
  return {'\0' + Bytes(&WriteColmapCameras, format, model.cameras),
          '\1' + Bytes(&WriteColmapImages, format, model.images),
          '\2' + Bytes(&WriteColmapPoints3D, format, model.points3D),
          '\3' + Bytes(&WriteColmapRigs, format, model.rigs),
          '\4' + Bytes(&WriteColmapFrames, format, model.frames)};
}

}  // namespace s2gs
