#pragma once

#include <cstdint>

#include "s2gs/core/host_device.h"

namespace s2gs {

/// 128 random bits.
struct Random4 {
  uint32_t words[4];
};

/// Philox4x32-10 of Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3" (SC 2011): a
/// keyed bijection of 128-bit counters. There is no state, so number i of a sequence costs the same for every
/// i, and any thread count, order or device gives the same numbers.
S2GS_HD inline Random4 Philox4x32(Random4 counter, uint32_t key0, uint32_t key1) {
  for (int round = 0; round < 10; ++round) {
    const uint64_t product0 = uint64_t{0xD2511F53u} * counter.words[0];
    const uint64_t product1 = uint64_t{0xCD9E8D57u} * counter.words[2];
    counter = {
        {static_cast<uint32_t>(product1 >> 32) ^ counter.words[1] ^ key0, static_cast<uint32_t>(product1),
         static_cast<uint32_t>(product0 >> 32) ^ counter.words[3] ^ key1, static_cast<uint32_t>(product0)}};
    key0 += 0x9E3779B9u;
    key1 += 0xBB67AE85u;
  }
  return counter;
}

/// Item `index` of the sequence `stream` of the generator `seed`: different arguments give independent
/// numbers.
S2GS_HD inline Random4 RandomBits(uint64_t seed, uint64_t stream, uint64_t index) {
  return Philox4x32({{static_cast<uint32_t>(index), static_cast<uint32_t>(index >> 32),
                      static_cast<uint32_t>(stream), static_cast<uint32_t>(stream >> 32)}},
                    static_cast<uint32_t>(seed), static_cast<uint32_t>(seed >> 32));
}

/// Uniform in [0, 1), a multiple of 2^-24: exact in float.
S2GS_HD inline float UnitFloat(uint32_t bits) { return static_cast<float>(bits >> 8) * 0x1p-24f; }

/// Uniform in [0, 1), a multiple of 2^-53.
S2GS_HD inline double UnitDouble(uint32_t high, uint32_t low) {
  return static_cast<double>(((uint64_t{high} << 32) | low) >> 11) * 0x1p-53;
}

/// Uniform in [0, 1), a multiple of 2^-32.
S2GS_HD inline double UnitDouble(uint32_t bits) { return bits * 0x1p-32; }

}  // namespace s2gs
