#include "sfm_split/scene/io/colmap_maps.h"

#include <limits>
#include <string>

#include "sfm_split/base/byte_reader.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr char kRemedy[] = "Run the stage that writes depth and normal maps first";  // where there is no file

// A positive decimal number that ends with '&'.
int ReadHeaderNumber(ByteReader& reader, const char* what) {
  int64_t number = 0;
  while (true) {
    const char c = reader.Read<char>(what);
    if (c == '&' && number > 0) return static_cast<int>(number);
    if (c < '0' || c > '9') {
      reader.Fail(std::string(what) + " of a map of floats must be a positive number followed by '&'");
    }
    number = 10 * number + (c - '0');
    if (number > std::numeric_limits<int>::max()) reader.Fail(std::string(what) + " is too large");
  }
}

}  // namespace

ColmapMap ReadColmapMap(std::istream& stream, const std::filesystem::path& path, int channels) {
  ByteReader reader(stream, path);
  ColmapMap map;
  map.width = ReadHeaderNumber(reader, "the width");
  map.height = ReadHeaderNumber(reader, "the height");
  map.channels = ReadHeaderNumber(reader, "the number of channels");
  if (map.channels != channels) {
    reader.Fail("the map has " + std::to_string(map.channels) + " channels, but " + std::to_string(channels) +
                " are wanted");
  }
  const uint64_t num_pixels = static_cast<uint64_t>(map.width) * static_cast<uint64_t>(map.height);
  reader.CheckCount(num_pixels, sizeof(float) * static_cast<uint64_t>(channels), "the number of pixels");
  map.values = reader.ReadVector<float>(num_pixels * static_cast<uint64_t>(channels), "the map's values");
  reader.ExpectEnd();
  return map;
}

ColmapMap ReadColmapMap(const std::filesystem::path& path, int channels) {
  std::ifstream stream = OpenForReading(path, kRemedy);
  return ReadColmapMap(stream, path, channels);
}

void WriteColmapMap(std::ostream& stream, const ColmapMap& map) {
  S2GS_INVARIANT(map.width > 0 && map.height > 0 && map.channels > 0);
  S2GS_INVARIANT(map.values.size() == map.Index(0, 0, map.channels));
  // Not through the stream's own number formatting, which a locale could group.
  const std::string header =
      std::to_string(map.width) + "&" + std::to_string(map.height) + "&" + std::to_string(map.channels) + "&";
  stream.write(header.data(), static_cast<std::streamsize>(header.size()));
  stream.write(reinterpret_cast<const char*>(map.values.data()),
               static_cast<std::streamsize>(map.values.size() * sizeof(float)));
}

void WriteColmapMap(const std::filesystem::path& path, const ColmapMap& map) {
  WriteFileAtomically(path, [&](std::ostream& stream) { WriteColmapMap(stream, map); });
}

}  // namespace s2gs
