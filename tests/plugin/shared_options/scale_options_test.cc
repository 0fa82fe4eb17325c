#include "plugin/shared_options/scale_options.h"

#include <gtest/gtest.h>

#include <sstream>

#include "plugin/cli/command.h"

namespace s2gs {
namespace {

ScaleOptions Parsed(const std::vector<std::string>& arguments) {
  std::ostringstream out;
  CommandContext context("model_scaler", arguments, out);
  Options& options = context.Declare("Scales.", "");
  ScaleOptions scale;
  AddScaleOptions(&options, &scale);
  context.Parse();
  return scale;
}

TEST(ScaleOptions, WhatIsStatedReachesTheOtherCommandUnchanged) {
  EXPECT_TRUE(ScaleArguments({}).empty());
  EXPECT_FALSE(ScaleOptions().HasAny());
  ScaleOptions scale;
  scale.marker_size_mm = 33.25;
  scale.marker_dictionary = "6X6";
  scale.marker_ids = {0, 4, 30};
  scale.known_length_mm = 334.3;
  scale.point_a = {"s1/a.jpg:10.5:20", "b.jpg:1:2"};
  scale.point_b = {"a.jpg:3:4", "b.jpg:5:6.125"};
  scale.disc_diameter_mm = 280;
  scale.disc_rim = {"a.jpg:1:1", "a.jpg:2:2", "c.jpg:3:3"};
  scale.charuco_columns = 7;
  scale.charuco_rows = 5;
  scale.charuco_square_mm = 40.5;
  const ScaleOptions parsed = Parsed(ScaleArguments(scale));
  EXPECT_EQ(parsed.marker_size_mm, scale.marker_size_mm);
  EXPECT_EQ(parsed.marker_dictionary, scale.marker_dictionary);
  EXPECT_EQ(parsed.marker_ids, scale.marker_ids);
  EXPECT_EQ(parsed.known_length_mm, scale.known_length_mm);
  EXPECT_EQ(parsed.point_a, scale.point_a);
  EXPECT_EQ(parsed.point_b, scale.point_b);
  EXPECT_EQ(parsed.disc_diameter_mm, scale.disc_diameter_mm);
  EXPECT_EQ(parsed.disc_rim, scale.disc_rim);
  EXPECT_EQ(parsed.charuco_columns, scale.charuco_columns);
  EXPECT_EQ(parsed.charuco_rows, scale.charuco_rows);
  EXPECT_EQ(parsed.charuco_square_mm, scale.charuco_square_mm);
}

// Each way to state a length asks for the scale alone; what says how markers look does not.
TEST(ScaleOptions, EachLengthIsOne) {
  EXPECT_TRUE(Parsed({"--marker_size_mm", "20"}).HasAny());
  EXPECT_TRUE(Parsed({"--known_length_mm", "20"}).HasAny());
  EXPECT_TRUE(Parsed({"--disc_diameter_mm", "20"}).HasAny());
  EXPECT_TRUE(Parsed({"--charuco_columns", "5"}).HasAny());
  EXPECT_FALSE(Parsed({"--marker_dictionary", "4X4", "--marker_ids", "1,2"}).HasAny());
  EXPECT_THROW(Parsed({"--disc_diameter_mm", "-1"}), CommandLineError);
}

TEST(ScaleOptions, HalfALengthIsRefused) {
  ScaleOptions scale;
  EXPECT_NO_THROW(RequireComplete(scale));
  scale.known_length_mm = 100;
  scale.point_a = {"a.jpg:1:2"};
  EXPECT_THROW(RequireComplete(scale), CommandLineError);
  scale.point_b = {"a.jpg:3:4"};
  EXPECT_NO_THROW(RequireComplete(scale));
  scale.disc_rim = {"a.jpg:3:4"};
  EXPECT_THROW(RequireComplete(scale), CommandLineError);
  scale.disc_diameter_mm = 300;
  EXPECT_NO_THROW(RequireComplete(scale));
  scale.point_b = {"a.jpg:3"};
  EXPECT_THROW(RequireComplete(scale), CommandLineError);
}

TEST(ScaleOptions, APlaceIsANameThatMayHaveColonsAndPixels) {
  const std::vector<PhotoPlace> places = ParsePhotoPlaces({"a:b.jpg:1.5:-2"}, "point_a");
  ASSERT_EQ(places.size(), 1U);
  EXPECT_EQ(places[0].name, "a:b.jpg");
  EXPECT_EQ(places[0].x, 1.5);
  EXPECT_EQ(places[0].y, -2);
}

}  // namespace
}  // namespace s2gs
