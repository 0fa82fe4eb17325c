#pragma once

#include <gtest/gtest.h>

#include <initializer_list>
#include <optional>
#include <string>

#include "sfm_split/base/error.h"
#include "sfm_split/base/number_text.h"

namespace s2gs {

/// Fails unless Check() of otherwise sound options accepts these values of a field, those on the bounds first
/// of all, and refuses those, naming the field and the value. \param sound  accepted as it is.
template <typename Options, typename Field, typename Value>
void ExpectBounds(const Options& sound, Field Options::*field, const std::string& name,
                  std::initializer_list<Value> accepted, std::initializer_list<Value> refused) {
  const OptionCheck as_it_is = sound.Check();
  ASSERT_FALSE(as_it_is) << as_it_is->field;
  for (const Value value : accepted) {
    Options options = sound;
    options.*field = static_cast<Field>(value);
    const OptionCheck fault = options.Check();
    EXPECT_FALSE(fault) << name << " = " << value << " violates " << fault->bound;
  }
  for (const Value value : refused) {
    Options options = sound;
    options.*field = static_cast<Field>(value);
    const OptionCheck fault = options.Check();
    ASSERT_TRUE(fault) << name << " = " << value;
    EXPECT_EQ(fault->field, name) << value;
    EXPECT_EQ(fault->value, NumberText(static_cast<double>(value))) << name;
  }
}

}  // namespace s2gs
