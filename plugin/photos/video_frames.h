#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// The ffmpeg executable: the one given, or in the folder given, or on PATH. Throws UserError when there is
/// none.
std::filesystem::path FindFfmpeg(const std::filesystem::path& ffmpeg_path);

/// The frames, counted from 0, that are sharpest in each of `num_frames` intervals of equal length; all when
/// there are no more than that. Sorted.
std::vector<size_t> SharpestOfIntervals(const std::vector<double>& sharpness, size_t num_frames);

/// How sharp each frame of a video is: the mean of what is brighter than the four pixels around it, by a
/// Laplacian of the full-size grey frame (ffmpeg's convolution and signalstats). Throws UserError when ffmpeg
/// cannot read the video, Interrupted.
std::vector<double> MeasureSharpness(const std::filesystem::path& ffmpeg, const std::filesystem::path& video,
                                     Reporter& reporter);

/// Writes the sharpest frame of each interval into the workspace's folder of imported photos, upright, as
/// frame_NNNNNN.png by its number in the video. Throws UserError when the video is no video, or has fewer
/// than three frames.
void ImportVideo(const std::filesystem::path& ffmpeg, const std::filesystem::path& video, int num_frames,
                 const Workspace& workspace, Reporter& reporter);

}  // namespace s2gs
