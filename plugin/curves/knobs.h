#pragma once

#include <string>
#include <utility>
#include <vector>

namespace s2gs {

/// Which part of a scan a knob belongs to, and with it what its error is.
enum class KnobStage { kPoses, kTraining, kMesh };

/// What one value of a knob stands for, where it is more than a value of the knob's option.
struct KnobSetting {
  std::string value;    ///< its name.
  std::string command;  ///< that gets the options; empty: none does.
  std::vector<std::pair<std::string, std::string>> options;
};

/// An option of a command that buys accuracy with time.
struct Knob {
  std::string name;
  std::string what;  ///< a phrase, e.g. "iterations of training".
  KnobStage stage = KnobStage::kMesh;
  std::string command;                ///< that has the option.
  std::string option;                 ///< without dashes, e.g. "Joint.function_tolerance".
  std::string from;                   ///< the first stage (StandardStages) that runs again for another value.
  std::vector<std::string> commands;  ///< that make a point, in order.
  std::vector<std::string> values;    ///< swept by default, from cheap to costly.
  std::vector<KnobSetting> settings;  ///< of the values; empty: each is a value of `option`.
  /// Options of `command` that every value gets, so that all are measured alike.
  std::vector<std::pair<std::string, std::string>> fixed = {};
};

const std::vector<Knob>& AllKnobs();

/// One of AllKnobs() by its name, or any option as COMMAND.OPTION, e.g. "tsdf_mesher.Tsdf.truncation_voxels".
/// Throws UserError, which lists the knobs, for another name.
Knob FindKnob(const std::string& name);

/// What the error of a stage is, measured against ground truth, and against the scan's own longest run.
/// Names are those of the point's figures.
struct KnobError {
  std::string figure;
  std::string text;  ///< with its unit, for axes.
};
KnobError ErrorOf(KnobStage stage, bool with_truth);

/// The error of a stage that a run tells by itself, without truth and without another run.
KnobError OwnErrorOf(KnobStage stage);

}  // namespace s2gs
