#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

namespace s2gs {

/// Where the kernel tells of control groups, versions 1 and 2.
struct ControlGroupFiles {
  std::filesystem::path of_process = "/proc/self/cgroup";
  std::filesystem::path mount = "/sys/fs/cgroup";
};

/// Cores' worth of time that the process's control groups grant, the least of its own and those above it;
/// nothing where none bounds it.
std::optional<double> ControlGroupCores(const ControlGroupFiles& files = {});

/// What the control groups leave of their memory [bytes]; pages of files that the kernel can drop count as
/// free. Nothing where none bounds it.
std::optional<uint64_t> ControlGroupMemoryBytes(const ControlGroupFiles& files = {});

/// What the system would still give this process without killing it [bytes]: the kernel's estimate, and what
/// the control groups leave. The largest number where neither is known.
uint64_t AvailableMemoryBytes();

/// Cores that this process may use, at least 1: by its affinity and its control groups.
int UsableCores();

/// How many threads OpenMP takes by itself, or fewer where each needs so much memory that no more of them fit
/// into what is free; at least 1.
int ThreadsThatFit(uint64_t bytes_of_each);

/// Makes UsableCores() what OpenMP takes by itself, unless OMP_NUM_THREADS says something else: OpenMP knows
/// the affinity, but no control groups.
void UseNoMoreThanUsableCores();

}  // namespace s2gs
