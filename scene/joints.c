/* What rigs call their joints: a row a joint, a column a family of rigs. */
#include "scene/joints.h"

#include <string.h>

/* own, .asf, MotionBuilder, Poser, SMPL, Mixamo, game */
const joint_row joint_rows[] = {
    { { "Hips", "root", "Hips", "hip", "pelvis", "Hips", "pelvis" }, JOINT_KEEP, NULL },
    { { "LowerBack", "lowerback", "LowerBack", "lowerback", "spine1", "Spine", "spine_01" }, JOINT_KEEP, NULL },
    { { "Spine", "upperback", "Spine", "abdomen", "spine2", "Spine1", "spine_02" }, JOINT_KEEP, NULL },
    { { "Spine1", "thorax", "Spine1", "chest", "spine3", "Spine2", "spine_03" }, JOINT_KEEP, NULL },
    { { "Neck", "lowerneck", "Neck", "neck", "neck", "Neck", "neck_01" }, JOINT_KEEP, NULL },
    { { "Neck1", "upperneck", "Neck1", "neck1", NULL, NULL, NULL }, JOINT_KEEP, NULL },
    { { "Head", "head", "Head", "head", "head", "Head", "head" }, JOINT_KEEP, NULL },
    { { "LeftShoulder", "lclavicle", "LeftShoulder", "lcollar", "left_collar", "LeftShoulder", "clavicle_l" },
      JOINT_KEEP,
      NULL },
    { { "LeftArm", "lhumerus", "LeftArm", "lshoulder", "left_shoulder", "LeftArm", "upperarm_l" },
      JOINT_CHAIN,
      "LeftForeArm" },
    { { "LeftForeArm", "lradius", "LeftForeArm", "lelbow", "left_elbow", "LeftForeArm", "lowerarm_l" },
      JOINT_CHAIN,
      "LeftHand" },
    { { "LeftHand", "lwrist", "LeftHand", "lhand", "left_wrist", "LeftHand", "hand_l" }, JOINT_PARENT, NULL },
    { { "LeftFingerBase", "lhand", "LeftFingerBase", "leftfingerbase", "left_hand", NULL, NULL }, JOINT_PARENT, NULL },
    { { "LeftHandFinger1", "lfingers", "LFingers", "lefthandindex1", "left_middle1", "LeftHandMiddle1", "middle_01_l" },
      JOINT_PARENT,
      NULL },
    { { "LThumb", "lthumb", "LThumb", "lthumb", "left_thumb1", "LeftHandThumb1", "thumb_01_l" }, JOINT_PARENT, NULL },
    { { "RightShoulder", "rclavicle", "RightShoulder", "rcollar", "right_collar", "RightShoulder", "clavicle_r" },
      JOINT_KEEP,
      NULL },
    { { "RightArm", "rhumerus", "RightArm", "rshoulder", "right_shoulder", "RightArm", "upperarm_r" },
      JOINT_CHAIN,
      "RightForeArm" },
    { { "RightForeArm", "rradius", "RightForeArm", "relbow", "right_elbow", "RightForeArm", "lowerarm_r" },
      JOINT_CHAIN,
      "RightHand" },
    { { "RightHand", "rwrist", "RightHand", "rhand", "right_wrist", "RightHand", "hand_r" }, JOINT_PARENT, NULL },
    { { "RightFingerBase", "rhand", "RightFingerBase", "rightfingerbase", "right_hand", NULL, NULL },
      JOINT_PARENT,
      NULL },
    { { "RightHandFinger1", "rfingers", "RFingers", "righthandindex1", "right_middle1", "RightHandMiddle1",
        "middle_01_r" },
      JOINT_PARENT,
      NULL },
    { { "RThumb", "rthumb", "RThumb", "rthumb", "right_thumb1", "RightHandThumb1", "thumb_01_r" }, JOINT_PARENT, NULL },
    { { "LHipJoint", "lhipjoint", "LHipJoint", "lhipjoint", NULL, NULL, NULL }, JOINT_KEEP, NULL },
    { { "LeftUpLeg", "lfemur", "LeftUpLeg", "lhip", "left_hip", "LeftUpLeg", "thigh_l" }, JOINT_CHAIN, "LeftLeg" },
    { { "LeftLeg", "ltibia", "LeftLeg", "lknee", "left_knee", "LeftLeg", "calf_l" }, JOINT_CHAIN, "LeftFoot" },
    { { "LeftFoot", "lfoot", "LeftFoot", "lfoot", "left_ankle", "LeftFoot", "foot_l" }, JOINT_SOLE, "LeftLeg" },
    { { "LeftToeBase", "ltoes", "LeftToeBase", "lefttoebase", "left_foot", "LeftToeBase", "ball_l" },
      JOINT_SOLE,
      "LeftLeg" },
    { { "RHipJoint", "rhipjoint", "RHipJoint", "rhipjoint", NULL, NULL, NULL }, JOINT_KEEP, NULL },
    { { "RightUpLeg", "rfemur", "RightUpLeg", "rhip", "right_hip", "RightUpLeg", "thigh_r" }, JOINT_CHAIN, "RightLeg" },
    { { "RightLeg", "rtibia", "RightLeg", "rknee", "right_knee", "RightLeg", "calf_r" }, JOINT_CHAIN, "RightFoot" },
    { { "RightFoot", "rfoot", "RightFoot", "rfoot", "right_ankle", "RightFoot", "foot_r" }, JOINT_SOLE, "RightLeg" },
    { { "RightToeBase", "rtoes", "RightToeBase", "righttoebase", "right_foot", "RightToeBase", "ball_r" },
      JOINT_SOLE,
      "RightLeg" },
};
const int joint_row_count = (int)(sizeof joint_rows / sizeof *joint_rows);

/* A name without what some programs put before it ("mixamorig:Hips"). */
static const char *bare(const char *name)
{
    const char *colon = strrchr(name, ':');
    return colon ? colon + 1 : name;
}

int joints_find(char *const *names, int64_t n, const char *name)
{
    for (int64_t j = 0; j < n; j++)
        if (names[j] && strcmp(names[j], name) == 0) return (int)j;
    return -1;
}

int joints_find_row(char *const *names, int64_t n, const joint_row *row, joint_family family)
{
    const char *name = row->name[family];
    if (!name) return -1;
    for (int64_t j = 0; j < n; j++)
        if (names[j] && strcmp(family == JOINTS_MIXAMO ? bare(names[j]) : names[j], name) == 0) return (int)j;
    return -1;
}

joint_family joints_family(char *const *names, int64_t n)
{
    joint_family best = JOINTS_OWN;
    int best_count = -1;
    for (int family = 0; family < JOINTS_FAMILIES; family++) {
        int count = 0;
        for (int i = 0; i < joint_row_count; i++)
            count += joints_find_row(names, n, joint_rows + i, (joint_family)family) >= 0;
        if (count > best_count) best = (joint_family)family, best_count = count;
    }
    return best;
}

const joint_row *joints_row(const char *name, joint_family family)
{
    const char *given = family == JOINTS_MIXAMO ? bare(name) : name;
    for (int i = 0; i < joint_row_count; i++)
        if (joint_rows[i].name[family] && strcmp(joint_rows[i].name[family], given) == 0) return joint_rows + i;
    return NULL;
}

bool joints_flat(joint_family family)
{
    return family == JOINTS_SMPL || family == JOINTS_MIXAMO || family == JOINTS_GAME;
}

/* ---- SMPL ---------------------------------------------------------------------------------------------------- */

#define BODY_22                                                                                                        \
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",     \
        "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",           \
        "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"
#define FINGERS(side_)                                                                                                 \
    side_ "_index1", side_ "_index2", side_ "_index3", side_ "_middle1", side_ "_middle2", side_ "_middle3",           \
        side_ "_pinky1", side_ "_pinky2", side_ "_pinky3", side_ "_ring1", side_ "_ring2", side_ "_ring3",             \
        side_ "_thumb1", side_ "_thumb2", side_ "_thumb3"
#define PARENTS_22 -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19
#define FINGER_PARENTS(wrist_, first_)                                                                                 \
    wrist_, first_, first_ + 1, wrist_, first_ + 3, first_ + 4, wrist_, first_ + 6, first_ + 7, wrist_, first_ + 9,    \
        first_ + 10, wrist_, first_ + 12, first_ + 13

static const char *const smpl_24[] = { BODY_22, "left_hand", "right_hand" };
static const char *const smpl_52[] = { BODY_22, FINGERS("left"), FINGERS("right") };
static const char *const smpl_55[] = { BODY_22,         "jaw",           "left_eye_smplhf", "right_eye_smplhf",
                                       FINGERS("left"), FINGERS("right") };
static const int32_t parents_24[] = { PARENTS_22, 20, 21 };
static const int32_t parents_52[] = { PARENTS_22, FINGER_PARENTS(20, 22), FINGER_PARENTS(21, 37) };
static const int32_t parents_55[] = { PARENTS_22, 15, 15, 15, FINGER_PARENTS(20, 25), FINGER_PARENTS(21, 40) };

const char *const *joints_smpl(int64_t count)
{
    return count == 55 ? smpl_55 : count == 52 ? smpl_52 : count == 24 || count == 22 ? smpl_24 : NULL;
}

const int32_t *joints_smpl_parents(int64_t count)
{
    return count == 55 ? parents_55 : count == 52 ? parents_52 : count == 24 || count == 22 ? parents_24 : NULL;
}
