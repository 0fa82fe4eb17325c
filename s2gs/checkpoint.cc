#include "s2gs/checkpoint.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <string_view>
#include <utility>
#include <vector>

#define XXH_INLINE_ALL
#include <xxhash.h>

#include "sfm_split/base/byte_reader.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr std::string_view kMagic = "S2GSCKPT";
constexpr uint32_t kVersion = 2;
constexpr uint64_t kMaxSettings = 1 << 16;
constexpr int kMaxNeighbours = 1024;
constexpr uint64_t kMaxCourse = 1 << 16;
constexpr size_t kBlock = size_t{1} << 20;

// Writes and hashes at once.
class Writer {
 public:
  explicit Writer(std::ostream* stream) : stream_(stream) { XXH3_64bits_reset(&hash_); }

  template <typename T>
  void Put(const T& value) {
    PutBytes(&value, sizeof(T));
  }
  template <typename T>
  void PutRows(const std::vector<T>& values) {
    if (!values.empty()) PutBytes(values.data(), values.size() * sizeof(T));
  }
  void PutBytes(const void* bytes, size_t count) {
    XXH3_64bits_update(&hash_, bytes, count);
    size_ += count;
    if (stream_ != nullptr)
      stream_->write(static_cast<const char*>(bytes), static_cast<std::streamsize>(count));
  }

  uint64_t hash() const { return XXH3_64bits_digest(&hash_); }
  uint64_t size() const { return size_; }

 private:
  std::ostream* stream_;  // null: only measures.
  XXH3_state_t hash_;
  uint64_t size_ = 0;
};

// The arrays of a model with the floats per Gaussian of each.
template <typename Model, typename Visit>
void ForEachArray(Model& model, const Visit& visit) {
  visit(model.centre, 3);
  visit(model.log_scale, 2);
  visit(model.rotation, 4);
  visit(model.opacity_logit, 1);
  visit(model.sh_dc, 3);
  visit(model.sh_rest, 3 * kShRestPerChannel);
  visit(model.foreground_logit, 1);
}

void PutContent(const Checkpoint& checkpoint, Writer* writer) {
  const TrainCursor& cursor = checkpoint.cursor;
  writer->Put<int64_t>(cursor.iteration);
  writer->Put(cursor.progress);
  writer->Put<uint64_t>(cursor.seed);
  writer->Put(cursor.wall_seconds);
  writer->Put(cursor.cpu_seconds);
  writer->Put(cursor.measuring_seconds);
  writer->Put<uint8_t>(cursor.foreground_frozen ? 1 : 0);
  writer->Put<int64_t>(cursor.last_densified);
  writer->Put<int64_t>(cursor.last_reset);
  writer->Put<int64_t>(cursor.initial_count);
  writer->Put<int64_t>(cursor.neighbours_turn);
  writer->Put<int64_t>(cursor.num_unseen_static);
  writer->Put<uint64_t>(cursor.held_out_course.points().size());
  for (const HeldOutCourse::Point& point : cursor.held_out_course.points()) {
    writer->Put(point.progress);
    writer->Put(point.error);
  }
  writer->Put<uint64_t>(cursor.settings.size());
  writer->PutBytes(cursor.settings.data(), cursor.settings.size());

  const TrainState& state = checkpoint.state;
  const uint64_t count = state.gaussians.size();
  writer->Put<uint64_t>(count);
  writer->Put<int32_t>(state.gaussians.sh_degree);
  writer->Put<int32_t>(state.num_neighbours);
  writer->Put<uint8_t>(state.first_moment.empty() ? 0 : 1);
  writer->Put<uint8_t>(state.gradient_sum.empty() ? 0 : 1);
  const auto put = [&](const std::vector<float>& rows, int) { writer->PutRows(rows); };
  ForEachArray(state.gaussians, put);
  if (!state.first_moment.empty()) {
    ForEachArray(state.first_moment, put);
    ForEachArray(state.second_moment, put);
  }
  if (!state.gradient_sum.empty()) {
    writer->PutRows(state.gradient_sum);
    writer->PutRows(state.view_count);
  }
  writer->PutRows(state.neighbours);
}

bool ReadFlag(ByteReader* reader, const char* what) {
  const auto value = reader->Read<uint8_t>(what);
  if (value > 1) reader->Fail(std::string(what) + " is neither 0 nor 1");
  return value == 1;
}

void CheckHash(std::istream& stream, const std::filesystem::path& path, uint64_t size, uint64_t expected) {
  const std::istream::pos_type begin = stream.tellg();
  XXH3_state_t hash;
  XXH3_64bits_reset(&hash);
  std::vector<char> block(std::min<uint64_t>(kBlock, size));
  for (uint64_t left = size; left > 0;) {
    const uint64_t part = std::min<uint64_t>(left, block.size());
    stream.read(block.data(), static_cast<std::streamsize>(part));
    if (!stream) throw UserError(path, "cannot be read", "Check the disk");
    XXH3_64bits_update(&hash, block.data(), part);
    left -= part;
  }
  if (XXH3_64bits_digest(&hash) != expected) {
    throw UserError(
        path, "is damaged: its checksum does not fit its content, bytes 28 to " + std::to_string(28 + size),
        "Remove it; training then starts from an older checkpoint or anew");
  }
  stream.seekg(begin);
}

TrainCursor ReadCursor(ByteReader* reader) {
  TrainCursor cursor;
  cursor.iteration = reader->Read<int64_t>("iteration");
  if (cursor.iteration < 0) reader->Fail("the iteration is negative");
  cursor.progress = reader->Read<double>("progress");
  if (!(cursor.progress >= 0 && cursor.progress <= 1)) reader->Fail("the progress is not 0 to 1");
  cursor.seed = reader->Read<uint64_t>("seed");
  cursor.wall_seconds = reader->Read<double>("wall seconds");
  cursor.cpu_seconds = reader->Read<double>("CPU seconds");
  cursor.measuring_seconds = reader->Read<double>("measuring seconds");
  cursor.foreground_frozen = ReadFlag(reader, "frozen flag");
  cursor.last_densified = reader->Read<int64_t>("last densification");
  cursor.last_reset = reader->Read<int64_t>("last reset");
  cursor.initial_count = reader->Read<int64_t>("first count");
  cursor.neighbours_turn = reader->Read<int64_t>("neighbours' turn");
  cursor.num_unseen_static = reader->Read<int64_t>("number of unseen Gaussians");
  const uint64_t num_points = reader->ReadCount(2 * sizeof(double), "number of held-out errors");
  if (num_points > kMaxCourse) reader->Fail("there are too many held-out errors");
  for (uint64_t i = 0; i < num_points; ++i) {
    const auto progress = reader->Read<double>("progress of a held-out error");
    const auto error = reader->Read<double>("held-out error");
    if (!(progress >= 0 && progress <= 1) || !(error > 0)) reader->Fail("a held-out error is impossible");
    cursor.held_out_course.Add(progress, error);
  }
  const uint64_t length = reader->ReadCount(1, "length of the settings");
  if (length > kMaxSettings) reader->Fail("the settings are too long");
  cursor.settings.resize(length);
  reader->ReadBytes(cursor.settings.data(), length, "settings");
  return cursor;
}

TrainState ReadState(ByteReader* reader) {
  TrainState state;
  const auto count = reader->Read<uint64_t>("number of Gaussians");
  const auto sh_degree = reader->Read<int32_t>("degree of spherical harmonics");
  if (sh_degree < 0 || sh_degree > kMaxShDegree)
    reader->Fail("the degree of spherical harmonics is not 0 to 3");
  state.num_neighbours = reader->Read<int32_t>("number of neighbours");
  if (state.num_neighbours < 0 || state.num_neighbours > kMaxNeighbours) {
    reader->Fail("the number of neighbours is impossible");
  }
  const bool has_moments = ReadFlag(reader, "moments flag");
  const bool has_statistics = ReadFlag(reader, "statistics flag");
  reader->CheckCount(count, kFloatsPerGaussian * sizeof(float), "Gaussians");
  const auto read = [&](std::vector<float>& rows, int width) {
    rows = reader->ReadVector<float>(count * width, "parameters");
  };
  ForEachArray(state.gaussians, read);
  state.gaussians.sh_degree = sh_degree;
  if (has_moments) {
    ForEachArray(state.first_moment, read);
    ForEachArray(state.second_moment, read);
    state.first_moment.sh_degree = sh_degree;
    state.second_moment.sh_degree = sh_degree;
  }
  if (has_statistics) {
    state.gradient_sum = reader->ReadVector<float>(count, "gradient sums");
    state.view_count = reader->ReadVector<float>(count, "view counts");
  }
  state.neighbours = reader->ReadVector<uint32_t>(count * state.num_neighbours, "neighbours");
  for (const uint32_t index : state.neighbours) {
    if (index >= count) reader->Fail("a neighbour does not exist");
  }
  return state;
}

}  // namespace

void WriteCheckpoint(std::ostream& stream, const Checkpoint& checkpoint) {
  Writer measure(nullptr);
  PutContent(checkpoint, &measure);
  const uint64_t size = measure.size();
  const uint64_t hash = measure.hash();
  stream.write(kMagic.data(), static_cast<std::streamsize>(kMagic.size()));
  stream.write(reinterpret_cast<const char*>(&kVersion), sizeof(kVersion));
  stream.write(reinterpret_cast<const char*>(&size), sizeof(size));
  stream.write(reinterpret_cast<const char*>(&hash), sizeof(hash));
  Writer writer(&stream);
  PutContent(checkpoint, &writer);
}

void WriteCheckpoint(const std::filesystem::path& path, const Checkpoint& checkpoint) {
  WriteFileAtomically(path, [&](std::ostream& stream) { WriteCheckpoint(stream, checkpoint); });
}

Checkpoint ReadCheckpoint(std::istream& stream, const std::filesystem::path& path) {
  ByteReader header(stream, path);
  std::array<char, kMagic.size()> magic{};
  header.ReadBytes(magic.data(), magic.size(), "magic bytes");
  if (std::string_view(magic.data(), magic.size()) != kMagic) header.Fail("is no checkpoint of s2gs");
  const auto version = header.Read<uint32_t>("version");
  if (version != kVersion) {
    header.Fail("has version " + std::to_string(version) + ", this program reads " +
                std::to_string(kVersion));
  }
  const auto size = header.Read<uint64_t>("content length");
  const auto hash = header.Read<uint64_t>("checksum");
  if (size != header.remaining()) {
    header.Fail("promises " + std::to_string(size) + " bytes of content, but " +
                std::to_string(header.remaining()) + " follow");
  }
  CheckHash(stream, path, size, hash);
  ByteReader reader(stream, path);
  Checkpoint checkpoint;
  checkpoint.cursor = ReadCursor(&reader);
  checkpoint.state = ReadState(&reader);
  reader.ExpectEnd();
  return checkpoint;
}

Checkpoint ReadCheckpoint(const std::filesystem::path& path) {
  std::ifstream stream = OpenForReading(path, "Start training without resuming");
  return ReadCheckpoint(stream, path);
}

}  // namespace s2gs
