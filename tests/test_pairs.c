/* Many pairs of a groom and a pose at once: what each is when it is draped alone, for both families, at rest and in motion; the
 * same bits for any threads; nothing is allocated from pair to pair; and what is wrong is said before anything is draped. */
#include "tests/hair_scene.h"

static const char strands_text[] =
    "scene: { grooms: [wavy, short], strands: 40, vertices: 7, seconds: 1 s, motion_kinds: [nod], held_out_kinds: "
    "[turn] }\n"
    "model: { width: 16 }\n"
    "features: { pose_joints: [Head, Neck], velocity_joints: [Head], latent: 3, lock_size: 16, encoder_width: 8, "
    "encoder_steps: 5 }\n"
    "losses: { gravity: {} }\n"
    "training: { strands: 20, frames: 1 }\n";
static const char grooms_text[] =
    "scene: { grooms: [wavy, short], strands: 40, vertices: 7, seconds: 1 s, motion_kinds: [nod], held_out_kinds: "
    "[turn] }\n"
    "model: { kind: quaffure, texture: 16, width: 8, depth: 1 }\n"
    "features: { pose_joints: [Head, Neck], velocity_joints: [Head], latent: 3, encoder_width: 8, encoder_steps: 5 }\n"
    "losses: { gravity: {} }\n"
    "training: { strands: 20, frames: 1 }\n";
static const char *const texts[2] = { strands_text, grooms_text };
static const char *const in_motion[][2] = { { "features.history", "2" } };
static const char *const at_rest[][2] = { { "features.history", "0" } };

enum { N = 11, FLOATS = 40 * 7 * 3 };
static const double shapes[2][HG_SHAPES] = { { 0.3, -0.2 }, { -0.6, 0, 0.5 } };

/* Grooms, one of them not trained on, clips, frames and shapes in no order. */
static void make_pairs(trial *s, hg_drape_pair pairs[N])
{
    int curly;
    OK(hg_hair_find_groom(s->task, "curly", &curly));
    assert_int_equal(curly, 2);
    assert_string_equal(hg_hair_groom_name(s->task, curly), "curly");
    for (int i = 0; i < N; i++)
        pairs[i] = (hg_drape_pair){ .groom = i * 7 % 3,
                                    .motion = hg_hair_clip(s->task, i % 2, 0),
                                    .frame = i * 13 % 28,
                                    .shape = i % 3 ? shapes[i % 3 - 1] : NULL };
}

typedef struct {
    int64_t strands[N];
    float x[N][FLOATS];
    int64_t next, allocated; /* when everything had been seen */
    bool steady, bodies;
} result;

static hg_status keep(void *self, int64_t pair, const hg_drape_frame *frame)
{
    result *r = self;
    assert_int_equal(pair, r->next);
    const int64_t seen =
        test_device() ? 3 : 1; /* a device keeps something of each of the three grooms when it first sees it */
    if (r->next++ < seen) r->allocated = hg_alloc_count();
    if (hg_alloc_count() != r->allocated) r->steady = false;
    assert_true(frame->strands * frame->vertices * 3 <= FLOATS);
    assert_int_equal(frame->body_vertices != NULL, r->bodies);
    assert_int_equal(frame->posed != NULL, r->bodies);
    r->strands[pair] = frame->strands;
    memcpy(r->x[pair], frame->x, (size_t)(frame->strands * frame->vertices) * 3 * sizeof(float));
    return HG_OK;
}

static hg_status keep_frame(void *self, const hg_drape_frame *frame)
{
    result *r = self;
    r->strands[0] = frame->strands;
    memcpy(r->x[0], frame->x, (size_t)(frame->strands * frame->vertices) * 3 * sizeof(float));
    return HG_OK;
}

static void drape(trial *s, const hg_drape_pair *pairs, int64_t stride, int64_t together, bool bodies, result *r)
{
    *r = (result){ .steady = true, .bodies = bodies };
    const hg_drape_pairs_options options = {
        .stride = stride, .together = together, .bodies = bodies, .posed = bodies
    };
    OK(hg_hair_drape_pairs(s->task, s->ctx, N, pairs, &options, keep, r, NULL));
    assert_int_equal(r->next, N);
}

static double largest_difference(const result *a, const result *b, double *largest)
{
    double worst = 0;
    for (int i = 0; i < N; i++) {
        assert_int_equal(a->strands[i], b->strands[i]);
        for (int64_t k = 0; k < a->strands[i] * 7 * 3; k++) {
            worst = fmax(worst, fabs((double)a->x[i][k] - (double)b->x[i][k]));
            *largest = fmax(*largest, fabs((double)a->x[i][k]));
        }
    }
    return worst;
}

/* Strands are predicted by the same products either way: the same bits. A product of one row may add up in another order than
 * one of several, which images of many pairs are: a millionth of the largest coordinate. */
static void same_as_alone(const char *text, const char *const (*set)[2])
{
    trial s = trial_begin(text, NULL, 2, 1, set);
    trial_wake(&s);
    hg_drape_pair pairs[N];
    make_pairs(&s, pairs);
    result *alone = calloc(1, sizeof *alone), *one = calloc(1, sizeof *one), *many = calloc(1, sizeof *many);
    assert_true(alone && one && many);
    static const char *const names[] = { "wavy", "short", "curly" };
    for (int i = 0; i < N; i++) {
        OK(hg_hair_choose_groom(s.task, names[pairs[i].groom]));
        OK(hg_hair_drape(s.task, s.ctx, pairs[i].motion, pairs[i].shape, pairs[i].frame, 1, 1, keep_frame, one, NULL));
        alone->strands[i] = one->strands[0];
        memcpy(alone->x[i], one->x[0], sizeof alone->x[i]);
    }
    const int64_t together[] = { 1, 4, 0 }; /* 4: the last turn is not full */
    for (int k = 0; k < 3; k++) {
        drape(&s, pairs, 1, together[k], k == 1, many);
        double largest = 0;
        const double worst = largest_difference(alone, many, &largest);
        const double allowed = text == strands_text || together[k] == 1 ? 0 : 1e-6 * largest;
        if (worst > allowed) fail_msg("%lld at once: off by %.3e of %.3e", (long long)together[k], worst, largest);
        if (!many->steady) fail_msg("%lld at once: memory was taken between pairs", (long long)together[k]);
    }
    /* Pairs differ, and the network moves the hair. */
    drape(&s, pairs, 3, 0, true, many);
    assert_true(many->strands[0] == (alone->strands[0] + 2) / 3);
    assert_true(memcmp(alone->x[0], alone->x[3], sizeof alone->x[0]) != 0);
    free(alone);
    free(one);
    free(many);
    trial_end(&s);
}

static void pairs_are_single_drapes(void **state)
{
    (void)state;
    for (int family = 0; family < 2; family++) {
        same_as_alone(texts[family], at_rest);
        same_as_alone(texts[family], in_motion);
    }
}

static void the_same_for_any_threads(void **state)
{
    (void)state;
    for (int family = 0; family < 2; family++) {
        result *r[2] = { calloc(1, sizeof(result)), calloc(1, sizeof(result)) };
        assert_true(r[0] && r[1]);
        for (int k = 0; k < 2; k++) {
            trial s = trial_begin(texts[family], NULL, k + 1, 1, in_motion);
            trial_wake(&s);
            hg_drape_pair pairs[N];
            make_pairs(&s, pairs);
            drape(&s, pairs, 1, 4, false, r[k]);
            trial_end(&s);
        }
        assert_memory_equal(r[0]->x, r[1]->x, sizeof r[0]->x);
        free(r[0]);
        free(r[1]);
    }
}

static hg_status stop_at_third(void *self, int64_t pair, const hg_drape_frame *frame)
{
    (void)self;
    (void)frame;
    return pair == 2 ? hg_fail(HG_IO, "no room for pair 2") : HG_OK;
}

static void refused(trial *s, int64_t n, const hg_drape_pair *pairs, int64_t stride, const char *words)
{
    result *r = calloc(1, sizeof *r);
    assert_non_null(r);
    const hg_drape_pairs_options options = { .stride = stride };
    assert_int_equal(hg_hair_drape_pairs(s->task, s->ctx, n, pairs, &options, keep, r, NULL), HG_INVALID);
    if (!strstr(hg_message(), words)) fail_msg("\"%s\" is not in: %s", words, hg_message());
    assert_int_equal(r->next, 0);
    free(r);
}

static void what_is_wrong(void **state)
{
    (void)state;
    for (int family = 0; family < 2; family++) {
        trial s = trial_begin(texts[family], NULL, 1, 0, NULL);
        hg_drape_pair pairs[N];
        make_pairs(&s, pairs);
        refused(&s, 0, pairs, 1, "0 pairs");
        refused(&s, N, pairs, -1, "stride of -1");
        pairs[4].groom = 3;
        refused(&s, N, pairs, 1, "pair 4: groom 3 of 3");
        pairs[4].groom = 0, pairs[10].frame = pairs[10].motion->frames;
        refused(&s, N, pairs, 1, "pair 10: frame");
        pairs[10].frame = 3, pairs[9].motion = NULL;
        refused(&s, N, pairs, 1, "pair 9");
        make_pairs(&s, pairs);
        assert_int_equal(hg_hair_drape_pairs(s.task, s.ctx, N, pairs, NULL, stop_at_third, NULL, NULL), HG_IO);
        assert_string_equal(hg_message(), "no room for pair 2");
        int none;
        assert_int_not_equal(hg_hair_find_groom(s.task, "wavvy", &none), HG_OK);
        result *r = calloc(1, sizeof *r); /* and all of it works on */
        drape(&s, pairs, 1, 0, false, r);
        free(r);
        trial_end(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pairs_are_single_drapes),
        cmocka_unit_test(the_same_for_any_threads),
        cmocka_unit_test(what_is_wrong),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
