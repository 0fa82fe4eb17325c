#pragma once

#include "plugin/report/report_input.h"
#include "plugin/report/scan_summary.h"

namespace s2gs {

/// The parts of the report, in the order in which it shows them. Each says what is missing instead of
/// failing; a damaged picture is warned about.

/// One sentence that judges the scan, why, what to do next, and the key figures.
/// \param summary  with CollectFigures().
ReportSection VerdictSection(const ReportInput& input, const ScanSummary& summary);

/// Stages with their times, and what was left out with the reason.
/// \param summary  of the scanner's last run, with CollectFigures().
ReportSection StagesSection(const ReportInput& input, const ScanSummary& summary);

/// Every photo: thumbnail, residual, blur, exposure, and why one has no pose.
ReportSection PhotosSection(const ReportInput& input, Reporter& reporter);

/// The table's angles by station, and the cameras from above and from the side.
ReportSection TableSection(const ReportInput& input);

/// Residuals over the frame and by size, lengths of tracks, which photos see the same points.
ReportSection ResidualsSection(const ReportInput& input);

/// Focal lengths, distortion, angles, axis and scale with their standard deviations, and what they rest on.
ReportSection GeometrySection(const ReportInput& input);

/// Keypoints by body over the photos; photo, rendering, mask and error against each other.
ReportSection PicturesSection(const ReportInput& input, Reporter& reporter);

/// The mesh in a viewer, with how many photos see each place and its holes; sizes.
ReportSection MeshSection(const ReportInput& input, Reporter& reporter);

/// Error against time: poses, training, mesh.
ReportSection CurvesSection(const ReportInput& input);

/// Command lines, versions, options, hashes.
ReportSection ProvenanceSection(const ReportInput& input, const ScanSummary& summary, Reporter& reporter);

}  // namespace s2gs
