#include "s2gs/core/available_memory.h"

#include <algorithm>
#include <fstream>
#include <limits>
#include <string>
#include <utility>

namespace s2gs {
namespace {

// The first number of a file of the kernel, or `otherwise` ("max", or no such file).
uint64_t NumberIn(const char* path, uint64_t otherwise) {
  std::ifstream file(path);
  uint64_t value = 0;
  return file >> value ? value : otherwise;
}

}  // namespace

uint64_t AvailableMemoryBytes() {
  constexpr uint64_t kUnknown = std::numeric_limits<uint64_t>::max();
  uint64_t available = kUnknown;
  std::ifstream file("/proc/meminfo");
  std::string name;
  while (file >> name) {
    uint64_t kib = 0;
    if (name == "MemAvailable:" && file >> kib) {
      available = kib << 10U;
      break;
    }
    file.ignore(std::numeric_limits<std::streamsize>::max(), '\n');
  }
  // Version 2 of control groups, as a container sees its own, and version 1.
  for (const auto& [limit, used] : {std::pair("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
                                    std::pair("/sys/fs/cgroup/memory/memory.limit_in_bytes",
                                              "/sys/fs/cgroup/memory/memory.usage_in_bytes")}) {
    const uint64_t most = NumberIn(limit, kUnknown);
    if (most == kUnknown) continue;
    available = std::min(available, most - std::min(most, NumberIn(used, 0)));
  }
  return available;
}

}  // namespace s2gs
