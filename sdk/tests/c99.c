/* The header is plain C99: this file only has to compile. */
#include "pathfold/pathfold.h"

int pathfold_c99_compiles(void);
int pathfold_c99_compiles(void) {
    float pixel[3] = {0, 0, 0};
    pathfold_image image = pathfold_packed(pixel, PATHFOLD_FLOAT32, 1, 1, 1, 3);
    return image.row_stride == 12;
}
