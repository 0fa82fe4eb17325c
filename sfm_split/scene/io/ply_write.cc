#include <algorithm>
#include <charconv>
#include <cstring>
#include <limits>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/ply_file.h"

namespace s2gs {
namespace {

constexpr size_t kBlockBytes = size_t{1} << 17;  // of one call of the stream; fits the cache of a core

bool IsName(const std::string& name) {
  return !name.empty() && name.find_first_of(" \t\r\n\v\f") == std::string::npos;
}

uint64_t MaxListSize(PlyType size_type) {
  switch (size_type) {
    case PlyType::kInt8:
      return std::numeric_limits<int8_t>::max();
    case PlyType::kUint8:
      return std::numeric_limits<uint8_t>::max();
    case PlyType::kInt16:
      return std::numeric_limits<int16_t>::max();
    case PlyType::kUint16:
      return std::numeric_limits<uint16_t>::max();
    case PlyType::kInt32:
      return std::numeric_limits<int32_t>::max();
    case PlyType::kUint32:
      return std::numeric_limits<uint32_t>::max();
    default:
      return 0;
  }
}

void CheckInvariants(const PlyElement& element) {
  S2GS_INVARIANT(IsName(element.name));
  S2GS_INVARIANT(element.num_rows == 0 || !element.properties.empty());
  for (const PlyProperty& property : element.properties) {
    S2GS_INVARIANT(IsName(property.name) && element.Find(property.name) == &property);
    const size_t num_values = std::visit([](const auto& values) { return values.size(); }, property.values);
    if (!property.is_list()) {
      S2GS_INVARIANT(num_values == element.num_rows);
      continue;
    }
    S2GS_INVARIANT(*property.list_size_type < PlyType::kFloat32);
    S2GS_INVARIANT(property.list_begins.size() == element.num_rows + 1);
    S2GS_INVARIANT(property.list_begins.front() == 0 && property.list_begins.back() == num_values);
    const uint64_t max_size = MaxListSize(*property.list_size_type);
    for (uint64_t row = 0; row < element.num_rows; ++row) {
      const uint64_t begin = property.list_begins[row];
      const uint64_t end = property.list_begins[row + 1];
      S2GS_INVARIANT(begin <= end && end - begin <= max_size);
    }
  }
}

void AppendRemarks(const char* keyword, const std::vector<std::string>& remarks, std::string& header) {
  for (const std::string& remark : remarks) {
    size_t begin = 0;
    while (begin <= remark.size()) {
      const size_t end = std::min(remark.find_first_of("\r\n", begin), remark.size());
      header += keyword;
      if (end > begin) header += ' ';
      header.append(remark, begin, end - begin);
      header += '\n';
      begin = end + 1;
    }
  }
}

std::string Header(const PlyFile& file) {
  std::string header = "ply\nformat ";
  switch (file.format) {
    case PlyFormat::kAscii:
      header += "ascii";
      break;
    case PlyFormat::kBinaryLittleEndian:
      header += "binary_little_endian";
      break;
    case PlyFormat::kBinaryBigEndian:
      header += "binary_big_endian";
      break;
  }
  header += " 1.0\n";
  AppendRemarks("comment", file.comments, header);
  AppendRemarks("obj_info", file.obj_info, header);
  for (const PlyElement& element : file.elements) {
    header += "element " + element.name + " " + std::to_string(element.num_rows) + "\n";
    for (const PlyProperty& property : element.properties) {
      header += "property ";
      if (property.is_list()) header += std::string("list ") + PlyTypeName(*property.list_size_type) + " ";
      header += std::string(PlyTypeName(property.type())) + " " + property.name + "\n";
    }
  }
  return header + "end_header\n";
}

class Output {
 public:
  explicit Output(std::ostream& stream) : stream_(stream) { block_.reserve(2 * kBlockBytes); }

  std::string& block() { return block_; }
  void FlushIfFull() {
    if (block_.size() >= kBlockBytes) Flush();
  }
  void Flush() {
    stream_.write(block_.data(), static_cast<std::streamsize>(block_.size()));
    block_.clear();
  }

 private:
  std::ostream& stream_;
  std::string block_;
};

// --- Text --------------------------------------------------------------------------------------------------

template <typename T>
void AppendText(T value, std::string& text) {
  char digits[32];
  const auto printed = std::to_chars(digits, digits + sizeof(digits), value);
  text.append(digits, printed.ptr);
}

void WriteTextRow(const PlyElement& element, uint64_t row, std::string& text) {
  for (const PlyProperty& property : element.properties) {
    uint64_t begin = row;
    uint64_t end = row + 1;
    if (property.is_list()) {
      begin = property.list_begins[row];
      end = property.list_begins[row + 1];
      AppendText(end - begin, text);
      text += ' ';
    }
    std::visit(
        [&](const auto& values) {
          for (uint64_t i = begin; i < end; ++i) {
            AppendText(values[i], text);
            text += ' ';
          }
        },
        property.values);
  }
  text.back() = '\n';
}

// --- Binary ------------------------------------------------------------------------------------------------

template <bool kSwap, typename T>
void StoreColumn(const T* values, uint64_t count, size_t stride, char* bytes) {
  for (uint64_t i = 0; i < count; ++i) {
    char* target = bytes + i * stride;
    std::memcpy(target, values + i, sizeof(T));
    if constexpr (kSwap && sizeof(T) > 1) std::reverse(target, target + sizeof(T));
  }
}

template <bool kSwap>
void AppendListSize(PlyType type, uint64_t size, std::string& block) {
  char bytes[sizeof(size)];
  std::memcpy(bytes, &size, sizeof(size));
  const size_t num_bytes = PlyTypeSize(type);
  if (kSwap) std::reverse(bytes, bytes + num_bytes);
  block.append(bytes, num_bytes);
}

template <bool kSwap>
void AppendBinaryRow(const PlyElement& element, uint64_t row, std::string& block) {
  for (const PlyProperty& property : element.properties) {
    uint64_t begin = row;
    uint64_t count = 1;
    if (property.is_list()) {
      begin = property.list_begins[row];
      count = property.list_begins[row + 1] - begin;
      AppendListSize<kSwap>(*property.list_size_type, count, block);
    }
    const size_t item_bytes = PlyTypeSize(property.type());
    const size_t old_size = block.size();
    block.resize(old_size + count * item_bytes);
    std::visit(
        [&](const auto& values) {
          StoreColumn<kSwap>(values.data() + begin, count, item_bytes, block.data() + old_size);
        },
        property.values);
  }
}

template <bool kSwap>
void WriteFixedRows(const PlyElement& element, Output& output) {
  size_t row_bytes = 0;
  for (const PlyProperty& property : element.properties) row_bytes += PlyTypeSize(property.type());
  const uint64_t rows_per_block = std::max<uint64_t>(1, kBlockBytes / std::max<size_t>(1, row_bytes));
  output.Flush();
  for (uint64_t row = 0; row < element.num_rows; row += rows_per_block) {
    const uint64_t count = std::min(rows_per_block, element.num_rows - row);
    output.block().resize(count * row_bytes);
    char* bytes = output.block().data();
    for (const PlyProperty& property : element.properties) {
      std::visit(
          [&](const auto& values) { StoreColumn<kSwap>(values.data() + row, count, row_bytes, bytes); },
          property.values);
      bytes += PlyTypeSize(property.type());
    }
    output.Flush();
  }
}

template <bool kSwap>
void WriteBinaryRows(const PlyElement& element, Output& output) {
  const bool has_list = std::any_of(element.properties.begin(), element.properties.end(),
                                    [](const PlyProperty& property) { return property.is_list(); });
  if (!has_list) {
    WriteFixedRows<kSwap>(element, output);
    return;
  }
  for (uint64_t row = 0; row < element.num_rows; ++row) {
    AppendBinaryRow<kSwap>(element, row, output.block());
    output.FlushIfFull();
  }
}

}  // namespace

void WritePly(std::ostream& stream, const PlyFile& file) {
  for (const PlyElement& element : file.elements) {
    S2GS_INVARIANT(file.Find(element.name) == &element);
    CheckInvariants(element);
  }
  Output output(stream);
  output.block() += Header(file);
  for (const PlyElement& element : file.elements) {
    switch (file.format) {
      case PlyFormat::kAscii:
        for (uint64_t row = 0; row < element.num_rows; ++row) {
          WriteTextRow(element, row, output.block());
          output.FlushIfFull();
        }
        break;
      case PlyFormat::kBinaryLittleEndian:
        WriteBinaryRows<false>(element, output);
        break;
      case PlyFormat::kBinaryBigEndian:
        WriteBinaryRows<true>(element, output);
        break;
    }
  }
  output.Flush();
}

void WritePly(const std::filesystem::path& path, const PlyFile& file) {
  WriteFileAtomically(path, [&](std::ostream& stream) { WritePly(stream, file); });
}

}  // namespace s2gs
