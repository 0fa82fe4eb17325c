#pragma once

#include <vector>

namespace s2gs {

/// Photos that show a pixel's background: of fewer the largest difference among them is hardly one.
constexpr int kLeastBackgrounds = 4;

/// By how much photos differ at a pixel where they show nothing but the background.
struct BackgroundRange {
  double most = 0;    ///< [grey values]; one photo in ten may show what passes by, and differ by more.
  double chance = 1;  ///< of a further photo of the background to differ by more, if all are alike.
};

/// \param differences  of kLeastBackgrounds photos or more from their median, not negative; they are sorted
/// in part.
BackgroundRange FindBackgroundRange(std::vector<double>* differences);

/// Photos at one place of a scene, each of which may differ from what it would show if nothing were there.
struct BackgroundVotes {
  int photos = 0;
  int differ = 0;
  double chance = 0;  ///< of each of the photos to differ where nothing is, added.
};

/// What such photos say of a place.
enum class BackgroundSight { kUnknown, kThere, kNotThere };

/// Whether photos differ as often as where something is, or as by chance: what is likelier, and only where
/// the less likely would be expected less than a hundredth times. \param as_thing  share of the photos that
/// differ where something is. \param num_places  that are asked about.
BackgroundSight Weigh(const BackgroundVotes& votes, double as_thing, int num_places);

/// Whether photos differ more often than chance makes them, judged alone.
bool DifferBeyondChance(const BackgroundVotes& votes);

/// The share of photos that differ where something is, by those of a known one. By Laplace's rule of
/// succession: what was always so is not certain, and without photos all is likely.
double ShareWhereSomethingIs(const BackgroundVotes& of_known);

}  // namespace s2gs
