#include <cstdlib>

#include <gtest/gtest.h>

int main(int count, char **arguments) {
    setenv("PATHFOLD_ONNXRUNTIME", TEST_ONNXRUNTIME, 0); // one that is set already wins
    testing::InitGoogleTest(&count, arguments);
    return RUN_ALL_TESTS();
}
