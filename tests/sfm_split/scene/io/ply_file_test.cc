#include "sfm_split/scene/io/ply_file.h"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>
#include <locale>
#include <random>
#include <sstream>
#include <string>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

PlyFile Parse(const std::string& bytes) {
  std::istringstream stream(bytes);
  return ReadPly(stream, "a.ply");
}

std::string Print(const PlyFile& file) {
  std::ostringstream stream;
  WritePly(stream, file);
  return stream.str();
}

template <typename T>
const std::vector<T>& Values(const PlyFile& file, const char* element, const char* property) {
  return std::get<std::vector<T>>(file.Find(element)->Find(property)->values);
}

// Equal bit by bit, so that NaN equals itself and -0 differs from 0.
template <typename T>
bool SameBits(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

void ExpectSame(const PlyFile& a, const PlyFile& b) {
  EXPECT_EQ(a.comments, b.comments);
  EXPECT_EQ(a.obj_info, b.obj_info);
  ASSERT_EQ(a.elements.size(), b.elements.size());
  for (size_t e = 0; e < a.elements.size(); ++e) {
    EXPECT_EQ(a.elements[e].name, b.elements[e].name);
    EXPECT_EQ(a.elements[e].num_rows, b.elements[e].num_rows);
    ASSERT_EQ(a.elements[e].properties.size(), b.elements[e].properties.size());
    for (size_t p = 0; p < a.elements[e].properties.size(); ++p) {
      const PlyProperty& pa = a.elements[e].properties[p];
      const PlyProperty& pb = b.elements[e].properties[p];
      EXPECT_EQ(pa.name, pb.name);
      ASSERT_EQ(pa.type(), pb.type());
      EXPECT_EQ(pa.list_size_type, pb.list_size_type);
      EXPECT_EQ(pa.list_begins, pb.list_begins);
      std::visit(
          [&](const auto& values) {
            EXPECT_TRUE(SameBits(values, std::get<std::decay_t<decltype(values)>>(pb.values)))
                << a.elements[e].name << '.' << pa.name;
          },
          pa.values);
    }
  }
}

constexpr char kCubeCorner[] =
    "ply\n"
    "format ascii 1.0\n"
    "comment made by hand\n"
    "comment\n"
    "obj_info two  blanks\n"
    "element vertex 3\n"
    "property float x\n"
    "property double y\n"
    "property uchar red\n"
    "element face 2\n"
    "property list uchar int vertex_indices\n"
    "property short label\n"
    "end_header\n"
    "0 -1.5 255\n"
    "1e-10 0.1 0\n"
    "-3 1e+300 7\n"
    "3 0 1 2 -5\n"
    "0 6\n";

TEST(PlyFile, ReadsTextMadeByHandAndWritesItBack) {
  const PlyFile file = Parse(kCubeCorner);
  EXPECT_EQ(file.format, PlyFormat::kAscii);
  EXPECT_EQ(file.comments, (std::vector<std::string>{"made by hand", ""}));
  EXPECT_EQ(file.obj_info, (std::vector<std::string>{"two  blanks"}));
  EXPECT_EQ(Values<float>(file, "vertex", "x"), (std::vector<float>{0, 1e-10F, -3}));
  EXPECT_EQ(Values<double>(file, "vertex", "y"), (std::vector<double>{-1.5, .1, 1e300}));
  EXPECT_EQ(Values<uint8_t>(file, "vertex", "red"), (std::vector<uint8_t>{255, 0, 7}));
  EXPECT_EQ(Values<int32_t>(file, "face", "vertex_indices"), (std::vector<int32_t>{0, 1, 2}));
  EXPECT_EQ(file.Find("face")->Find("vertex_indices")->list_begins, (std::vector<uint64_t>{0, 3, 3}));
  EXPECT_EQ(Values<int16_t>(file, "face", "label"), (std::vector<int16_t>{-5, 6}));
  EXPECT_EQ(Print(file), kCubeCorner);
}

TEST(PlyFile, ReadsBinaryMadeByHandAndWritesItBack) {
  const std::string declarations =
      "element a 2\nproperty ushort s\nproperty float f\nelement b 1\nproperty list short uchar l\n"
      "end_header\n";
  const std::string little =
      "ply\nformat binary_little_endian 1.0\n" + declarations +
      std::string("\x01\x02\x00\x00\x80\x3f\xff\xff\x00\x00\x00\xc0\x02\x00\x07\x08", 16);
  const std::string big = "ply\nformat binary_big_endian 1.0\n" + declarations +
                          std::string("\x02\x01\x3f\x80\x00\x00\xff\xff\xc0\x00\x00\x00\x00\x02\x07\x08", 16);
  for (const std::string& bytes : {little, big}) {
    const PlyFile file = Parse(bytes);
    EXPECT_EQ(Values<uint16_t>(file, "a", "s"), (std::vector<uint16_t>{0x0201, 0xFFFF}));
    EXPECT_EQ(Values<float>(file, "a", "f"), (std::vector<float>{1, -2}));
    EXPECT_EQ(Values<uint8_t>(file, "b", "l"), (std::vector<uint8_t>{7, 8}));
    EXPECT_EQ(Print(file), bytes);
  }
}

TEST(PlyFile, AcceptsWhatOtherProgramsWrite) {
  // CRLF, sized type names, trailing blanks, empty lines, integers written as decimals, no final line end.
  const PlyFile text = Parse(
      "ply\r\nformat ascii 1.0\r\nelement vertex 2\r\nproperty float32 x\r\nproperty uint8 red\r\n"
      "end_header\r\n+1.5 255.0 \r\n\r\n  nan\t1e2");
  EXPECT_EQ(Values<uint8_t>(text, "vertex", "red"), (std::vector<uint8_t>{255, 100}));
  EXPECT_EQ(Values<float>(text, "vertex", "x")[0], 1.5F);
  EXPECT_TRUE(std::isnan(Values<float>(text, "vertex", "x")[1]));
  // The data begins right after the header's line end, even where it looks like another one.
  const PlyFile binary =
      Parse("ply\r\nformat binary_little_endian 1.0\r\nelement v 2\r\nproperty int8 c\r\nend_header\r\n\r\n");
  EXPECT_EQ(Values<int8_t>(binary, "v", "c"), (std::vector<int8_t>{'\r', '\n'}));
  // Below the smallest float.
  const PlyFile tiny =
      Parse("ply\nformat ascii 1.0\nelement v 2\nproperty float x\nend_header\n1e-60\n1e-40\n");
  EXPECT_EQ(Values<float>(tiny, "v", "x"), (std::vector<float>{0, 1e-40F}));
}

template <typename T>
std::vector<T> RandomValues(size_t count, std::mt19937& random) {
  std::vector<T> values(count);
  for (T& value : values) {
    const uint64_t bits = uint64_t{random()} << 32 | random();
    std::memcpy(&value, &bits, sizeof(T));
    // A NaN's payload has no text.
    if (std::is_floating_point_v<T> && !(value == value)) value = 0;
  }
  using Limits = std::numeric_limits<T>;
  for (const T value : {Limits::lowest(), Limits::max(), Limits::denorm_min(), static_cast<T>(-T{}),
                        Limits::infinity(), static_cast<T>(-Limits::infinity()), Limits::quiet_NaN()}) {
    values[random() % count] = value;
  }
  return values;
}

template <typename T>
void AddRandomColumns(size_t count, std::mt19937& random, PlyElement& element) {
  const std::string name = std::to_string(element.properties.size());
  element.AddColumn(name, RandomValues<T>(count, random));
  PlyProperty list;
  list.name = "list" + name;
  list.list_size_type = static_cast<PlyType>(random() % 6);
  list.list_begins = {0};
  for (size_t row = 0; row < count; ++row) list.list_begins.push_back(list.list_begins.back() + random() % 4);
  list.values = RandomValues<T>(list.list_begins.back(), random);
  element.properties.push_back(std::move(list));
}

PlyFile RandomFile(size_t num_rows) {
  std::mt19937 random(7);
  PlyFile file;
  file.comments = {"every type, as scalar and as list"};
  PlyElement lists;
  lists.name = "lists";
  lists.num_rows = num_rows;
  AddRandomColumns<int8_t>(num_rows, random, lists);
  AddRandomColumns<uint8_t>(num_rows, random, lists);
  AddRandomColumns<int16_t>(num_rows, random, lists);
  AddRandomColumns<uint16_t>(num_rows, random, lists);
  AddRandomColumns<int32_t>(num_rows, random, lists);
  AddRandomColumns<uint32_t>(num_rows, random, lists);
  AddRandomColumns<float>(num_rows, random, lists);
  AddRandomColumns<double>(num_rows, random, lists);
  PlyElement scalars;
  scalars.name = "scalars";
  scalars.num_rows = num_rows;
  for (const PlyProperty& property : lists.properties) {
    if (!property.is_list()) scalars.properties.push_back(property);
  }
  PlyElement empty;
  empty.name = "empty";
  file.elements = {lists, empty, scalars};
  return file;
}

TEST(PlyFile, EveryTypeAndFormatRoundTripsBitByBit) {
  // More rows than a block holds (2^18 bytes, rows of 28 or more).
  PlyFile file = RandomFile(20000);
  for (const PlyFormat format :
       {PlyFormat::kAscii, PlyFormat::kBinaryLittleEndian, PlyFormat::kBinaryBigEndian}) {
    file.format = format;
    const PlyFile read = Parse(Print(file));
    EXPECT_EQ(read.format, format);
    ExpectSame(read, file);
  }
}

TEST(PlyFile, ListLongerThanABlock) {
  PlyFile file;
  PlyElement element;
  element.name = "e";
  element.num_rows = 2;
  PlyProperty list{"l", std::vector<uint16_t>(300000, 12345), PlyType::kInt32, {0, 299999, 300000}};
  element.properties.push_back(list);
  file.elements.push_back(element);
  for (const PlyFormat format : {PlyFormat::kAscii, PlyFormat::kBinaryBigEndian}) {
    file.format = format;
    ExpectSame(Parse(Print(file)), file);
  }
}

class GroupingNumbers : public std::numpunct<char> {
 protected:
  char do_decimal_point() const override { return ','; }
  char do_thousands_sep() const override { return '.'; }
  std::string do_grouping() const override { return "\1"; }
};

TEST(PlyFile, DoesNotDependOnTheLocale) {
  const std::locale outer = std::locale::global(std::locale(std::locale(), new GroupingNumbers));
  PlyFile file = RandomFile(1000);
  file.format = PlyFormat::kAscii;
  const std::string text = Print(file);
  EXPECT_NE(text.find("element lists 1000\n"), std::string::npos);
  ExpectSame(Parse(text), file);
  std::locale::global(outer);
}

TEST(PlyFile, ManyLineCommentBecomesManyComments) {
  PlyFile file;
  file.comments = {"a\nend_header\r\nb"};
  EXPECT_EQ(Parse(Print(file)).comments, (std::vector<std::string>{"a", "end_header", "", "b"}));
}

TEST(PlyFile, Conversions) {
  EXPECT_EQ(PlyFloats(std::vector<int16_t>{-1, 2}), (std::vector<float>{-1, 2}));
  const PlyFile file = Parse(kCubeCorner);
  EXPECT_EQ(RequirePlyScalar(*file.Find("vertex"), "y", "a.ply").type(), PlyType::kFloat64);
  ExpectUserError([&] { RequirePlyScalar(*file.Find("vertex"), "w", "a.ply"); },
                  {"a.ply", "'vertex'", "'w'"});
  ExpectUserError([&] { RequirePlyScalar(*file.Find("face"), "vertex_indices", "a.ply"); }, {"a.ply"});
}

TEST(PlyHandMadeBadInput, Headers) {
  const std::string text = "ply\nformat ascii 1.0\n";
  const std::string binary = "ply\nformat binary_little_endian 1.0\n";
  const std::string huge = "18446744073709551615";
  const std::pair<std::string, const char*> cases[] = {
      {"", "ends inside its header"},
      {"plyx\n", "begins with the line 'ply'"},
      {"ply\nend_header\n", "no 'format'"},
      {"ply\nformat ascii 2.0\nend_header\n", "'2.0'"},
      {"ply\nformat utf8 1.0\nend_header\n", "'utf8'"},
      {text + "format ascii 1.0\nend_header\n", "second 'format'"},
      {text + "property int x\nend_header\n", "before the first element"},
      {text + "element v -1\nend_header\n", "'-1'"},
      {text + "element v 18446744073709551616\nend_header\n", "number of rows"},
      {text + "element v 1 2\nend_header\n", "unexpected '2'"},
      {text + "element v 1\nend_header\n\n", "no properties"},
      {binary + "element v " + huge + "\nend_header\n", "no properties"},
      {text + "element v 0\nelement v 0\nend_header\n", "second element 'v'"},
      {text + "element v 0\nproperty int a\nproperty int a\nend_header\n", "second property 'a'"},
      {text + "element v 0\nproperty int\nend_header\n", "no name"},
      {text + "element v 0\nproperty complex a\nend_header\n", "'complex'"},
      {text + "element v 0\nproperty list float int a\nend_header\n", "integer type"},
      {text + "bogus\nend_header\n", "'bogus'"},
      {text + "element v " + huge + "\nproperty uchar a\nend_header\n1\n", "can hold"},
      {binary + "element v " + huge + "\nproperty uchar a\nend_header\n1", "can hold"},
      {binary + "element v " + huge + "\nproperty list uchar double a\nend_header\n1", "can hold"},
      {text + "comment " + std::string(2 << 20, 'x') + "\nend_header\n", "longer than"},
      {text + std::string(1 << 20, '\n'), "is no line"},
  };
  const ScopedAllocationLimit limit(size_t{5} << 20);
  for (const auto& [bytes, problem] : cases) {
    ExpectUserError([&, b = bytes] { Parse(b); }, {"a.ply", problem}, bytes.substr(0, 80));
  }
}

TEST(PlyHandMadeBadInput, Rows) {
  const std::string text = "ply\nformat ascii 1.0\nelement v 1\n";
  const std::string binary = "ply\nformat binary_little_endian 1.0\nelement v 1\n";
  const std::pair<std::string, const char*> cases[] = {
      {text + "property uchar a\nend_header\n256\n", "'256' is no uchar"},
      {text + "property uchar a\nend_header\n-1\n", "'-1' is no uchar"},
      {text + "property char a\nend_header\n1.5\n", "'1.5' is no char"},
      {text + "property int a\nend_header\n0x10\n", "'0x10' is no int"},
      {text + "property int a\nend_header\nnan\n", "'nan' is no int"},
      {text + "property float a\nend_header\n1e39\n", "'1e39' is no float"},
      {text + "property float a\nend_header\n1,5\n", "'1,5' is no float"},
      {text + "property int a\nend_header\n1 2\n", "more values"},
      {text + "property int a\nproperty int b\nend_header\n1   \n", "line ends before property 'b'"},
      {text + "property int a\nend_header\n\n", "before row 0"},
      {text + "property int a\nend_header\n1\n2\n", "after the last element"},
      {text + "property list int int a\nend_header\n-1\n", "number of items"},
      {text + "property list int int a\nend_header\n3 100 2\n", "line ends before property 'a'"},
      {text + "property list uint int a\nend_header\n4294967295 1\n", "number of items"},
      {binary + "property int a\nend_header\n1234x", "1 bytes follow"},
      {binary + "property list char int a\nend_header\n\x81", "-127 items"},
      {binary + "property list uint int a\nend_header\n\xff\xff\xff\xff", "4294967295 items"},
      {binary + "property list uchar int a\nproperty int b\nend_header\n\x01" + std::string(4, '\0'),
       "ends inside"},
  };
  for (const auto& [bytes, problem] : cases) {
    ExpectUserError([&, b = bytes] { Parse(b); }, {"a.ply", problem}, bytes);
  }
  ExpectUserError([] { ReadPly("no/such/file.ply"); }, {"no/such/file.ply"});
}

class PlyFileBadInput : public testing::TestWithParam<PlyFormat> {};

TEST_P(PlyFileBadInput, EveryTruncationAndBitFlip) {
  PlyFile file = Parse(kCubeCorner);
  file.format = GetParam();
  const std::string bytes = Print(file);
  // A file of n bytes holds at most n rows, and a list's row takes eight bytes in memory.
  const ScopedAllocationLimit limit(16 * bytes.size());
  int num_accepted = 0;
  ForEachDamage(bytes, [&](const std::string& damaged, const std::string& description) {
    const bool accepted = ExpectOkOrUserError([&] { Parse(damaged); }, "a.ply", description);
    num_accepted += accepted;
    // The last row's last value cannot be seen to be short in text ("16" cut to "1").
    const bool is_cut = damaged.size() + (GetParam() == PlyFormat::kAscii ? 1 : 0) < bytes.size();
    EXPECT_FALSE(accepted && is_cut) << description;
  });
  EXPECT_GT(num_accepted, 0);
}

INSTANTIATE_TEST_SUITE_P(Formats, PlyFileBadInput,
                         testing::Values(PlyFormat::kAscii, PlyFormat::kBinaryLittleEndian,
                                         PlyFormat::kBinaryBigEndian));

}  // namespace
}  // namespace s2gs
