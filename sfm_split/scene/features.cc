#include "sfm_split/scene/features.h"

#include "sfm_split/base/error.h"

namespace s2gs {

const char* CaptureCaseName(CaptureCase capture_case) {
  switch (capture_case) {
    case CaptureCase::kTurntable:
      return "turntable";
    case CaptureCase::kSingleStation:
      return "single_station";
    case CaptureCase::kOneBody:
      return "one_body";
  }
  S2GS_INVARIANT(false);
  return "";
}

}  // namespace s2gs
