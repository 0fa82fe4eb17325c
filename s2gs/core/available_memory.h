#pragma once

#include <cstdint>

namespace s2gs {

/// What the system would still give this process without killing it [bytes]: the kernel's estimate, and what
/// the control group leaves. The largest number where neither is known.
uint64_t AvailableMemoryBytes();

}  // namespace s2gs
