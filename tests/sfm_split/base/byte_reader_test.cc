#include "sfm_split/base/byte_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <sstream>

#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

template <typename T>
void Append(std::string* bytes, T value) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(value));
}

// Everything that the reader offers, in one made-up format: u64 count, count doubles, a name, a u32.
void ReadSample(const std::string& bytes) {
  std::istringstream stream(bytes);
  ByteReader reader(stream, "sample.bin");
  const uint64_t count = reader.ReadCount(sizeof(double), "number of values");
  reader.ReadVector<double>(count, "values");
  reader.ReadCString(8, "name");
  reader.Read<uint32_t>("last");
  reader.ExpectEnd();
}

std::string Sample() {
  std::string bytes;
  Append<uint64_t>(&bytes, 3);
  for (const double value : {1.5, -2.5, 1e300}) Append(&bytes, value);
  bytes += std::string("front\0", 6);
  Append<uint32_t>(&bytes, 7);
  return bytes;
}

TEST(ByteReader, ReadsValuesInOrder) {
  std::string bytes;
  Append<uint8_t>(&bytes, 200);
  Append<int32_t>(&bytes, -5);
  Append<float>(&bytes, 0.25F);
  bytes += std::string("a b\0", 4);
  Append<uint16_t>(&bytes, 1);
  Append<uint16_t>(&bytes, 65535);
  std::istringstream stream(bytes);
  ByteReader reader(stream, "values.bin");
  EXPECT_EQ(reader.remaining(), bytes.size());
  EXPECT_EQ(reader.Read<uint8_t>("a"), 200);
  EXPECT_EQ(reader.Read<int32_t>("b"), -5);
  EXPECT_EQ(reader.offset(), 5U);
  EXPECT_EQ(reader.Read<float>("c"), 0.25F);
  EXPECT_EQ(reader.ReadCString(3, "d"), "a b");
  EXPECT_EQ(reader.ReadVector<uint16_t>(2, "e"), (std::vector<uint16_t>{1, 65535}));
  EXPECT_TRUE(reader.ReadVector<uint16_t>(0, "nothing").empty());
  EXPECT_NO_THROW(reader.ExpectEnd());
}

TEST(ByteReader, BeginsWhereTheStreamStands) {
  std::istringstream stream("skipped12");
  stream.seekg(7);
  ByteReader reader(stream, "x");
  EXPECT_EQ(reader.remaining(), 2U);
  EXPECT_EQ(reader.Read<char>("a"), '1');
  EXPECT_EQ(reader.offset(), 1U);
}

TEST(ByteReader, NamesPathOffsetAndWhat) {
  std::istringstream stream(std::string("12345"));
  ByteReader reader(stream, "cameras.bin");
  reader.Read<uint16_t>("model");
  ExpectUserError([&] { reader.Read<uint32_t>("width"); },
                  {"cameras.bin", "width", "4 bytes wanted, 3 left", "at byte 2"});
  // A failed read consumes nothing.
  EXPECT_EQ(reader.remaining(), 3U);
  ExpectUserError([&] { reader.ExpectEnd(); }, {"3 bytes follow"});
}

TEST(ByteReader, LimitsStrings) {
  std::istringstream stream(std::string("abcd\0", 5));
  ByteReader reader(stream, "x");
  ExpectUserError([&] { reader.ReadCString(3, "name"); }, {"longer than 3"});
  std::istringstream endless("abcd");
  ByteReader endless_reader(endless, "x");
  ExpectUserError([&] { endless_reader.ReadCString(100, "name"); }, {"ends inside name", "at byte 4"});
}

TEST(ByteReader, RefusesStreamsThatCannotSeek) {
  struct OneWay : std::stringbuf {
    pos_type seekoff(off_type, std::ios::seekdir, std::ios::openmode) override {
      return pos_type(off_type(-1));
    }
  } buffer;
  std::istream stream(&buffer);
  ExpectUserError([&] { const ByteReader reader(stream, "fifo"); }, {"fifo", "Only regular files"});
}

TEST(ByteReaderBadInput, DamagedSamples) {
  int num_refused = 0;
  ForEachDamage(Sample(), [&](const std::string& damaged, const std::string& description) {
    const ScopedAllocationLimit limit(4096);
    if (!ExpectOkOrUserError([&] { ReadSample(damaged); }, "sample.bin", description)) ++num_refused;
  });
  // Every truncation at least.
  EXPECT_GE(num_refused, static_cast<int>(Sample().size()));
}

TEST(ByteReaderBadInput, HostileCounts) {
  for (const uint64_t count :
       {uint64_t{1} << 63, ~uint64_t{0}, uint64_t{1} << 31, (uint64_t{1} << 61) + 1, uint64_t{6}}) {
    const ScopedAllocationLimit limit(4096);
    const std::string bytes = WithInteger(Sample(), 0, 8, count);
    ExpectUserError([&] { ReadSample(bytes); }, {"sample.bin", "at byte 8", "can hold no more than"});
    std::istringstream stream(bytes);
    ByteReader reader(stream, "direct");
    // 2^61 + 1 times 8 bytes is 8 in 64 bits.
    ExpectUserError([&] { reader.ReadVector<double>(count, "values"); }, {"direct", "values"});
  }
}

}  // namespace
}  // namespace s2gs
