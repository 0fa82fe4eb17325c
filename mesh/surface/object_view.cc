#include "mesh/surface/object_view.h"

namespace s2gs {

ObjectView CutAndShrunk(const ObjectView& view, const ImagePart& part, int factor) {
  ObjectView cut = view;
  cut.width = part.width / factor;
  cut.height = part.height / factor;
  cut.fx /= factor;
  cut.fy /= factor;
  cut.cx = (view.cx - part.x) / factor;
  cut.cy = (view.cy - part.y) / factor;
  return cut;
}

}  // namespace s2gs
