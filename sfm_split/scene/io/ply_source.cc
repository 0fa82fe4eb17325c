#include "sfm_split/scene/io/ply_source.h"

#include <algorithm>
#include <cstring>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// Large enough to make the cost of a read small, small enough to stay in the cache until it is unpacked.
constexpr uint64_t kBlockBytes = uint64_t{1} << 18;

// Of every fault.
constexpr char kRemedy[] = "The file is damaged or no PLY file: restore it, or write it again";

}  // namespace

void PlySource::Fill(uint64_t count) {
  if (buffered() >= count || reader_.remaining() == 0) return;
  const size_t kept = buffered();
  if (kept > 0 && begin_ > 0) std::memmove(buffer_.data(), buffer_.data() + begin_, kept);
  begin_ = 0;
  const uint64_t more = std::min(reader_.remaining(), std::max(count - kept, kBlockBytes));
  buffer_.resize(kept + more);
  reader_.ReadBytes(buffer_.data() + kept, more, "a block of data");
}

const char* PlySource::Take(uint64_t count, const std::string& what) {
  if (count > remaining()) {
    FailAtByte("the file ends inside " + what + " (" + std::to_string(count) + " bytes wanted, " +
               std::to_string(remaining()) + " left)");
  }
  Fill(count);
  const char* bytes = buffer_.data() + begin_;
  begin_ += count;
  return bytes;
}

std::string_view PlySource::TakeLine(uint64_t max_length) {
  ++line_;
  uint64_t searched = 0;
  while (true) {
    Fill(searched + 1);
    const char* begin = buffer_.data() + begin_;
    const auto* end =
        buffered() == searched
            ? nullptr
            : static_cast<const char*>(std::memchr(begin + searched, '\n', buffered() - searched));
    searched = end != nullptr ? static_cast<uint64_t>(end - begin) : buffered();
    if (searched > max_length) {
      FailAtLine("the line is longer than " + std::to_string(max_length) + " characters");
    }
    if (end == nullptr && reader_.remaining() > 0) continue;
    begin_ += searched + (end != nullptr ? 1 : 0);
    std::string_view line(begin, searched);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return line;
  }
}

void PlySource::FailAtByte(const std::string& problem) const {
  throw UserError(reader_.path(), problem + ", at byte " + std::to_string(offset()), kRemedy);
}

void PlySource::FailAtLine(const std::string& problem) const {
  throw UserError(reader_.path(), "line " + std::to_string(line_) + ": " + problem, kRemedy);
}

}  // namespace s2gs
