#include "sfm_split/base/machine_share.h"

#include <omp.h>
#include <sched.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// The first number of a file of the kernel; nothing for "max", -1 or no such file.
std::optional<uint64_t> NumberIn(const fs::path& path) {
  std::ifstream file(path);
  int64_t value = 0;
  if (file >> value && value >= 0) return static_cast<uint64_t>(value);
  return std::nullopt;
}

// The number after `name` in a file of lines "name number".
std::optional<uint64_t> NumberNamed(std::string_view name, const fs::path& path) {
  std::ifstream file(path);
  std::string word;
  while (file >> word) {
    uint64_t value = 0;
    if (word == name && file >> value) return value;
    file.ignore(std::numeric_limits<std::streamsize>::max(), '\n');
  }
  return std::nullopt;
}

// The folders of the process's group and of all above it, of version 2 (`controller` is empty) or of one
// controller of version 1. In a container the group's own path may not be there, but the mount is.
std::vector<fs::path> GroupFolders(std::string_view controller, const ControlGroupFiles& files) {
  const fs::path root = files.mount / controller;
  fs::path group;
  std::ifstream list(files.of_process);
  for (std::string line; std::getline(list, line);) {
    // "4:cpu,cpuacct:/a/b"; version 2 has no controllers.
    const size_t first = line.find(':');
    const size_t second = first == std::string::npos ? first : line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = "," + line.substr(first + 1, second - first - 1) + ",";
    const std::string wanted = "," + std::string(controller) + ",";
    const bool is_it =
        controller.empty() ? controllers == ",," : controllers.find(wanted) != std::string::npos;
    if (is_it) group = fs::path(line.substr(second + 1)).relative_path().lexically_normal();
  }
  std::vector<fs::path> folders;
  for (; !group.empty() && group != "." && *group.begin() != ".."; group = group.parent_path())
    folders.push_back(root / group);
  folders.push_back(root);
  return folders;
}

template <typename T>
void TakeLess(T value, std::optional<T>* least) {
  *least = std::min(least->value_or(value), value);
}

}  // namespace

std::optional<double> ControlGroupCores(const ControlGroupFiles& files) {
  std::optional<double> least;
  for (const fs::path& folder : GroupFolders("", files)) {
    std::ifstream file(folder / "cpu.max");
    double quota = 0, period = 0;
    if (file >> quota >> period && period > 0) TakeLess(quota / period, &least);
  }
  for (const fs::path& folder : GroupFolders("cpu", files)) {
    const std::optional<uint64_t> quota = NumberIn(folder / "cpu.cfs_quota_us");
    const std::optional<uint64_t> period = NumberIn(folder / "cpu.cfs_period_us");
    if (quota && period && *period > 0)
      TakeLess(static_cast<double>(*quota) / static_cast<double>(*period), &least);
  }
  return least;
}

std::optional<uint64_t> ControlGroupMemoryBytes(const ControlGroupFiles& files) {
  struct Version {
    const char* controller;
    const char* limit;
    const char* used;
    const char* droppable;
  };
  // Control groups 2 and 1: the kernel names the same four things differently.
  constexpr Version kVersions[] = {
      {"", "memory.max", "memory.current", "inactive_file"},
      {"memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"}};
  std::optional<uint64_t> least;
  for (const Version& version : kVersions) {
    for (const fs::path& folder : GroupFolders(version.controller, files)) {
      const std::optional<uint64_t> limit = NumberIn(folder / version.limit);
      if (!limit) continue;
      const uint64_t used = NumberIn(folder / version.used).value_or(0);
      const uint64_t droppable = NumberNamed(version.droppable, folder / "memory.stat").value_or(0);
      const uint64_t held = used - std::min(used, droppable);
      TakeLess(*limit - std::min(*limit, held), &least);
    }
  }
  return least;
}

uint64_t AvailableMemoryBytes() {
  uint64_t available = std::numeric_limits<uint64_t>::max();
  if (const std::optional<uint64_t> kib = NumberNamed("MemAvailable:", "/proc/meminfo"))
    available = *kib << 10U;
  return std::min(available, ControlGroupMemoryBytes().value_or(available));
}

int UsableCores() {
  auto cores = static_cast<int>(std::thread::hardware_concurrency());
  cpu_set_t allowed;
  // Fails with more than 1,024 processors, where hardware_concurrency() has to do.
  if (::sched_getaffinity(0, sizeof(allowed), &allowed) == 0) cores = CPU_COUNT(&allowed);
  if (const std::optional<double> granted = ControlGroupCores())
    cores = static_cast<int>(std::min<double>(cores, std::ceil(*granted)));
  return std::max(1, cores);
}

int ThreadsThatFit(uint64_t bytes_of_each) {
  const uint64_t fitting = AvailableMemoryBytes() / std::max<uint64_t>(bytes_of_each, 1);
  return static_cast<int>(std::clamp<uint64_t>(fitting, 1, static_cast<uint64_t>(omp_get_max_threads())));
}

void UseNoMoreThanUsableCores() {
  if (std::getenv("OMP_NUM_THREADS") == nullptr)
    omp_set_num_threads(std::min(omp_get_max_threads(), UsableCores()));
}

}  // namespace s2gs
