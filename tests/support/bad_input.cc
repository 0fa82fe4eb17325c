#include "tests/support/bad_input.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <limits>
#include <new>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr size_t kUnlimited = std::numeric_limits<size_t>::max();
thread_local size_t allocation_limit = kUnlimited;
thread_local size_t largest_request = 0;

bool Allowed(size_t size) {
  largest_request = std::max(largest_request, size);
  return size <= allocation_limit;
}

void* AllocateOrNull(size_t size) { return Allowed(size) ? std::malloc(std::max<size_t>(size, 1)) : nullptr; }

void* AllocateAlignedOrNull(size_t size, std::align_val_t alignment) {
  if (!Allowed(size) || size > kUnlimited / 2) return nullptr;
  const auto align = static_cast<size_t>(alignment);
  return std::aligned_alloc(align, (std::max<size_t>(size, 1) + align - 1) / align * align);
}

void* OrThrow(void* memory) {
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}

}  // namespace

void ForEachDamage(const std::string& bytes,
                   const std::function<void(const std::string&, const std::string&)>& check) {
  for (size_t size = 0; size < bytes.size(); ++size) {
    check(bytes.substr(0, size), "cut to " + std::to_string(size) + " bytes");
  }
  std::string damaged = bytes;
  for (size_t i = 0; i < bytes.size(); ++i) {
    for (int bit = 0; bit < 8; ++bit) {
      damaged[i] = static_cast<char>(bytes[i] ^ (1 << bit));
      check(damaged, "bit " + std::to_string(bit) + " of byte " + std::to_string(i) + " flipped");
    }
    damaged[i] = bytes[i];
  }
}

std::string WithInteger(std::string bytes, size_t offset, size_t size, uint64_t value) {
  for (size_t i = 0; i < size; ++i) bytes.at(offset + i) = static_cast<char>(value >> (8 * i));
  return bytes;
}

bool ExpectOkOrUserError(const std::function<void()>& read, const std::string& path_substring,
                         const std::string& description) {
  try {
    read();
    return true;
  } catch (const UserError& error) {
    if (std::string(error.what()).find(path_substring) == std::string::npos) {
      ADD_FAILURE() << description << ": the message does not name " << path_substring << ": "
                    << error.what();
    }
  } catch (const std::exception& error) {
    ADD_FAILURE() << description << ": not a UserError: " << error.what();
  }
  return false;
}

void ExpectUserError(const std::function<void()>& read, std::initializer_list<std::string> substrings,
                     const std::string& description) {
  try {
    read();
    ADD_FAILURE() << description << ": no error was thrown";
  } catch (const UserError& error) {
    for (const std::string& substring : substrings) {
      if (std::string(error.what()).find(substring) == std::string::npos) {
        ADD_FAILURE() << description << ": no \"" << substring << "\" in the message: " << error.what();
      }
    }
  } catch (const std::exception& error) {
    ADD_FAILURE() << description << ": not a UserError: " << error.what();
  }
}

ScopedAllocationLimit::ScopedAllocationLimit(size_t bytes)
    : limit_(bytes), outer_limit_(allocation_limit), outer_largest_(largest_request) {
  allocation_limit = bytes;
  largest_request = 0;
}

ScopedAllocationLimit::~ScopedAllocationLimit() {
  const size_t largest = largest_request;
  allocation_limit = outer_limit_;
  largest_request = std::max(largest, outer_largest_);
  if (largest > limit_) {
    ADD_FAILURE() << "a single allocation of " << largest << " bytes was requested, the limit is " << limit_;
  }
}

size_t ScopedAllocationLimit::LargestRequest() { return largest_request; }

}  // namespace s2gs

void* operator new(size_t size) { return s2gs::OrThrow(s2gs::AllocateOrNull(size)); }
void* operator new[](size_t size) { return s2gs::OrThrow(s2gs::AllocateOrNull(size)); }
void* operator new(size_t size, const std::nothrow_t&) noexcept { return s2gs::AllocateOrNull(size); }
void* operator new[](size_t size, const std::nothrow_t&) noexcept { return s2gs::AllocateOrNull(size); }
void* operator new(size_t size, std::align_val_t alignment) {
  return s2gs::OrThrow(s2gs::AllocateAlignedOrNull(size, alignment));
}
void* operator new[](size_t size, std::align_val_t alignment) {
  return s2gs::OrThrow(s2gs::AllocateAlignedOrNull(size, alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete[](void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }
void operator delete[](void* memory, size_t) noexcept { std::free(memory); }
void operator delete(void* memory, const std::nothrow_t&) noexcept { std::free(memory); }
void operator delete[](void* memory, const std::nothrow_t&) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, size_t, std::align_val_t) noexcept { std::free(memory); }
void operator delete[](void* memory, size_t, std::align_val_t) noexcept { std::free(memory); }
