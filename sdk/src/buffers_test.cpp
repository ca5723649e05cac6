#include "buffers.h"

#include <set>

#include "testing.h"

namespace pathfold::core {

TEST(Buffers, AreFoundByName) {
    std::set<std::string> names;
    for (const BufferKind &kind : buffer_kinds()) {
        EXPECT_TRUE(names.insert(kind.name).second) << kind.name;
        EXPECT_EQ(find_buffer(kind.name), &kind);
        EXPECT_EQ(kind.per_sample, std::string(kind.name).rfind("samples.", 0) == 0) << kind.name;
        EXPECT_NE(buffer_names().find(kind.name), std::string::npos);
    }
    EXPECT_EQ(find_buffer("albedo")->channels, 3);
    EXPECT_EQ(find_buffer("colour"), nullptr);
    EXPECT_EQ(find_buffer(""), nullptr);
}

TEST(Buffers, GuidesAreBuffersOfPixels) {
    for (const Guide &guide : guides()) {
        const BufferKind *kind = find_buffer(guide.name);
        ASSERT_NE(kind, nullptr) << guide.name;
        EXPECT_EQ(kind->per_sample, 0) << guide.name;
        EXPECT_LT(guide.meaning.range.least, guide.meaning.range.most) << guide.name;
        EXPECT_EQ(find_guide(guide.name), &guide);
    }
    EXPECT_EQ(find_guide("color"), nullptr);
    EXPECT_EQ(meaning_of("normal").range.least, -1);
    EXPECT_EQ(meaning_of("variance").range.least, 0);
}

} // namespace pathfold::core
