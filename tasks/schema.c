/* schema: every key of a hair config, with its default, unit and one line of help. The losses are not listed here: a
 * section per registered energy is made from its own declaration, so that a new energy needs no edit. */
#include "tasks/hair.h"

#include <pthread.h>
#include <string.h>

#define POSE_JOINTS     "[Head, Neck1, Neck, Spine1, LowerBack, LeftShoulder, RightShoulder]"
#define VELOCITY_JOINTS "[Head, Neck1, Neck, Spine1, LowerBack, Hips]"

static const hg_config_row rows[] = {
    /* ---- scene */
    { "scene.folder", HG_TEXT, "", NULL, NULL, 0, 0, "folder that the file names below are relative to" },
    { "scene.body", HG_TEXT, "", NULL, NULL, 0, 0, "body file (.h5); empty: the procedural bust" },
    { "scene.groom", HG_TEXT, "", NULL, NULL, 0, 0, "groom file (.h5); empty: grown on the body" },
    { "scene.grooms", HG_TEXTS, "", NULL, NULL, 0, 0,
      "several to train on at once: files (.h5) and styles of grown ones; their strands have as many vertices" },
    { "scene.motions", HG_TEXTS, "", NULL, NULL, 0, 0, "motion files (.h5) to train on; empty: procedural ones" },
    { "scene.held_out", HG_TEXTS, "", NULL, NULL, 0, 0, "motion files kept for validation and evaluation" },
    { "scene.linear_density", HG_NUMBER, "6.5e-6 kg/m", "kg/m", NULL, 1e-12, 1,
      "of a hair: 65 micrograms per centimetre" },
    { "scene.mirror", HG_FLAG, "false", NULL, NULL, 0, 0, "train on every motion file mirrored left to right too" },
    { "scene.varied", HG_INTEGER, "0", NULL, NULL, 0, 100,
      "times that every motion file is trained on with a made movement of the head on top of it, another each time" },
    { "scene.rate", HG_NUMBER, "30", "1/s", NULL, 1, 1000, "frames per second; motions are resampled to it" },
    { "scene.style", HG_CHOICE, "wavy", NULL, "straight|wavy|curly|short|long", 0, 0, "of a grown groom" },
    { "scene.strands", HG_INTEGER, "2000", NULL, NULL, 1, 1000000, "of a grown groom" },
    { "scene.vertices", HG_INTEGER, "25", NULL, NULL, 2, 256, "per strand of a grown groom" },
    { "scene.seconds", HG_NUMBER, "10", "s", NULL, 0.1, 3600, "length of each procedural motion" },
    { "scene.motion_kinds", HG_TEXTS, "[nod, turn, shake, walk, jump, mixed]", NULL, NULL, 0, 0,
      "procedural motions to train on: nod, turn, shake, walk, jump, mixed" },
    { "scene.held_out_kinds", HG_TEXTS, "[shake, mixed]", NULL, NULL, 0, 0, "procedural motions kept for evaluation" },
    { "scene.seed", HG_INTEGER, "1", NULL, NULL, 0, 1000000000, "of the grown groom and the procedural motions" },

    /* ---- body shapes */
    { "shapes.spread", HG_NUMBER, "1", "1", NULL, 0, 10, "times the deviations of the body file; 0: the neutral body" },

    /* ---- network */
    { "model.kind", HG_TEXT, "neuralocks", NULL, NULL, 0, 0, "architecture" },
    { "model.width", HG_INTEGER, "256", NULL, NULL, 1, 8192, "of a hidden layer" },
    { "model.depth", HG_INTEGER, "2", NULL, NULL, 1, 16, "hidden layers" },
    { "model.activation", HG_CHOICE, "silu", NULL, "identity|relu|leaky_relu|elu|tanh|sigmoid|silu|gelu|softplus", 0, 0,
      "of the hidden layers" },
    { "model.output", HG_CHOICE, "vertices", NULL, "vertices|edges|directions", 0, 0,
      "what the network predicts: displacements of vertices (published), of edges, summed from the root, or turns of "
      "edges "
      "that keep their lengths" },
    { "model.output_scale", HG_NUMBER, "10 mm", "m", NULL, 1e-6, 10, "displacement for an output of 1" },
    { "model.turn_scale", HG_NUMBER, "0.1", "1", NULL, 1e-6, 10,
      "directions: added to the unit direction for an output of 1" },
    { "model.space", HG_CHOICE, "head", NULL, "head|world", 0, 0,
      "axes of displacements: of the head at rest, which turn with it, or of the world (published for quaffure)" },
    { "model.texture", HG_INTEGER, "64", NULL, NULL, 2, 4096,
      "of a network that makes images: texels of a side, with a strand each; others are left out" },
    { "model.groups", HG_INTEGER, "0", NULL, NULL, 0, 8192,
      "of a network that makes images: of the group norm after each convolution but the last; 0: none" },
    { "model.orientations", HG_CHOICE, "asked", NULL, "asked|yes|no", 0, 0,
      "four more outputs for every edge, the turn of its frame: asked, where an energy is about orientations (the "
      "config of a run says yes or no)" },
    { "model.orientation_of", HG_CHOICE, "posed", NULL, "posed|edges", 0, 0,
      "what is turned by them: the frames of the posed groom's edges, or these carried to where the edges are" },
    { "model.orientation_scale", HG_NUMBER, "0.1", "1", NULL, 1e-6, 10,
      "added to the quaternion of a turn for an output of 1" },
    { "model.pinned", HG_INTEGER, "1", NULL, NULL, 1, 2,
      "vertices of a strand that move with the head: 1 the root, 2 its edge too" },

    /* ---- features */
    { "features.shape", HG_FLAG, "true", NULL, NULL, 0, 0, "the ten shape coefficients" },
    { "features.pose_joints", HG_TEXTS, POSE_JOINTS, NULL, NULL, 0, 0,
      "joints whose rotation is an input; Head: its heading is removed; [all]: those of the body" },
    { "features.rotation", HG_CHOICE, "columns", NULL, "columns|axis_angle", 0, 0,
      "a rotation as the first two columns of its matrix, or as axis times angle" },
    { "features.velocity_joints", HG_TEXTS, VELOCITY_JOINTS, NULL, NULL, 0, 0,
      "joints whose angular velocity is an input; [all]: those of the body" },
    { "features.linear", HG_CHOICE, "acceleration", NULL, "acceleration|velocity|none", 0, 0,
      "what the history holds of the head's linear motion; hair feels its acceleration only" },
    { "features.history", HG_INTEGER, "30", NULL, NULL, 0, 1000, "frames of velocities; 0: a quasi-static network" },
    { "features.latent", HG_INTEGER, "32", NULL, NULL, 1, 1024,
      "numbers that describe a strand, or a groom for a network that makes images" },
    { "features.lock_size", HG_INTEGER, "64", NULL, NULL, 1, 100000, "strands of a lock" },
    { "features.locks", HG_FLAG, "true", NULL, NULL, 0, 0,
      "a strand's inputs have the mean code of its lock beside its own (networks of strands)" },
    { "features.encoder_width", HG_INTEGER, "256", NULL, NULL, 1, 8192,
      "of the encoder's hidden layers, or the channels of its smallest image" },
    { "features.encoder_steps", HG_INTEGER, "1000", NULL, NULL, 1, 1000000,
      "training steps of the autoencoder that describes strands or grooms" },

    { "features.materials", HG_SECTION, NULL, NULL, NULL, 0, 0,
      "parameters of energies that are inputs of the network: ENERGY: { PARAMETER: [lowest, highest] }" },

    /* ---- losses: the common part */
    { "losses", HG_SECTION, NULL, NULL, NULL, 0, 0, "the energies, one section each" },

    /* ---- training */
    { "training.strands", HG_INTEGER, "3000", NULL, NULL, 1, 1000000,
      "strands that a step sees, drawn from the groom" },
    { "training.subset", HG_CHOICE, "locks", NULL, "locks|spread", 0, 0,
      "draw whole locks spread over the scalp, or strands spread over all locks" },
    { "training.resample_every", HG_INTEGER, "0", NULL, NULL, 0, 1000000000,
      "steps after which other strands are drawn; 0: never" },
    { "training.frames", HG_INTEGER, "1", NULL, NULL, 1, 256, "frames of a step, each with a body shape of its own" },
    { "training.consecutive", HG_INTEGER, "1", NULL, NULL, 1, 256,
      "the frames of a step are runs of so many that follow each other in a clip, with one body, groom and material; "
      "pose_reg needs at least 2" },
    { "training.steps", HG_INTEGER, "10000", NULL, NULL, 1, 1000000000, "" },
    { "training.learning_rate", HG_NUMBER, "5e-4", "1", NULL, 0, 1, "the largest, after the warm-up" },
    { "training.final_fraction", HG_NUMBER, "0.05", "1", NULL, 0, 1, "of the learning rate at the end of the cosine" },
    { "training.warm_up", HG_INTEGER, "100", NULL, NULL, 0, 1000000, "steps in which the learning rate rises" },
    { "training.clip", HG_NUMBER, "1", "1", NULL, 0, 1e9, "largest gradient norm; 0: no limit" },
    { "training.clip_vertex", HG_NUMBER, "0", "1", NULL, 0, 1e9,
      "largest force on a vertex that is learnt from, in weights of the mean vertex; 0: no limit" },
    { "training.ramp", HG_NUMBER, "0.5", "1", NULL, 0, 1,
      "part of the steps in which a stiffness with a `ramp` rises to its value" },
    { "training.beta1", HG_NUMBER, "0.9", "1", NULL, 0, 1, "of Adam" },
    { "training.beta2", HG_NUMBER, "0.999", "1", NULL, 0, 1, "of Adam" },
    { "training.epsilon", HG_NUMBER, "1e-8", "1", NULL, 0, 1, "of Adam" },
    { "training.weight_decay", HG_NUMBER, "0", "1", NULL, 0, 1, "decoupled" },
    { "training.log_every", HG_INTEGER, "20", NULL, NULL, 1, 1000000, "steps" },
    { "training.validate_every", HG_INTEGER, "500", NULL, NULL, 0, 1000000, "steps; 0: only at the end" },
    { "training.ema", HG_NUMBER, "0", "1", NULL, 0, 0.999999,
      "decay of a moving average of the weights, which is what is validated, kept and exported; 0: none" },
    { "training.patience", HG_INTEGER, "0", NULL, NULL, 0, 1000000,
      "validations without a better one after which training stops; 0: never" },
    { "training.tensorboard", HG_FLAG, "false", NULL, NULL, 0, 0, "write the log as TensorBoard events too" },
    { "training.start_from", HG_TEXT, "", NULL, NULL, 0, 0,
      "run or checkpoint (.h5) whose weights, strand encoder and normalisation training starts from; the optimiser is "
      "new" },
    { "training.validation_frames", HG_INTEGER, "16", NULL, NULL, 1, 10000, "held-out frames of a validation" },
    { "training.checkpoint_every", HG_INTEGER, "500", NULL, NULL, 0, 1000000, "steps; 0: only at the end" },
    { "training.seed", HG_INTEGER, "1", NULL, NULL, 0, 1000000000, "of weights, strands and frames" },
    { "training.compute", HG_CHOICE, "f32", NULL, "f32|tf32|bf16", 0, 0,
      "in what the factors of the network's products are rounded while it trains (tf32: on cuda alone); sums and "
      "weights are "
      "f32" },
    { "training.backend", HG_CHOICE, "auto", NULL, "auto|interpreter|compiled", 0, 0, "what runs the energies" },
};

/* A schema lives as long as the program: configs point into it. A plug-in may add energies after the first was made;
 * then another is made and the first stays. */
typedef struct schema {
    hg_config_row *rows;
    int n, energies;
    struct schema *older;
} schema;
static schema *newest;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

enum { ENERGIES = 256 };

int hg_hair_energies(const hg_energy **energies)
{
    const char *names[ENERGIES];
    int n = hg_list("energy", names, ENERGIES);
    if (n > ENERGIES) n = ENERGIES;
    for (int i = 0; i < n; i++) energies[i] = hg_find("energy", names[i]);
    return n;
}

static int energy_rows(const hg_energy *energy, hg_config_row *out)
{
    int n = 0;
    out[n++] = (hg_config_row){ .key = hg_format("features.materials.%s", energy->name),
                                .type = HG_SECTION,
                                .help = "ranges of its parameters" };
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name; i++)
        out[n++] = (hg_config_row){ .key = hg_format("features.materials.%s.%s", energy->name, energy->params[i].name),
                                    .type = HG_NUMBERS,
                                    .value = "",
                                    .unit = energy->params[i].unit,
                                    .help = "lowest and highest value: drawn for every frame of a step, and an input" };
    out[n++] =
        (hg_config_row){ .key = hg_format("losses.%s", energy->name), .type = HG_SECTION, .help = energy->equation };
    out[n++] = (hg_config_row){ .key = hg_format("losses.%s.weight", energy->name),
                                .type = HG_NUMBER,
                                .value = "0",
                                .unit = "1",
                                .help = "times the energy; 1 when its section is written without it" };
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name; i++)
        if (!strcmp(energy->params[i].name, "stiffness"))
            out[n++] = (hg_config_row){ .key = hg_format("losses.%s.ramp", energy->name),
                                        .type = HG_NUMBER,
                                        .value = "1",
                                        .unit = "1",
                                        .help = "times its stiffness in the first step, from where it rises over "
                                                "`training.ramp` of the training; in training alone" };
    if (energy->params[0].name)
        out[n++] = (hg_config_row){ .key = hg_format("losses.%s.learn", energy->name),
                                    .type = HG_TEXTS,
                                    .value = "",
                                    .help = "parameters that are learnt, from the values given here" };
    for (int i = 0; i < HG_ENERGY_PARAMS && energy->params[i].name; i++) {
        const hg_energy_param *param = &energy->params[i];
        out[n++] = (hg_config_row){ .key = hg_format("losses.%s.%s", energy->name, param->name),
                                    .type = HG_NUMBER,
                                    .value = hg_format("%.9g", param->value),
                                    .unit = param->unit,
                                    .help = param->help };
    }
    for (int i = 0; i < HG_ENERGY_OPTIONS && energy->options[i].name; i++) {
        const hg_energy_option *option = &energy->options[i];
        out[n++] = (hg_config_row){ .key = hg_format("losses.%s.%s", energy->name, option->name),
                                    .type = HG_CHOICE,
                                    .value = option->value,
                                    .choices = option->choices,
                                    .help = option->help };
    }
    return n;
}

static schema *schema_make(void)
{
    const hg_energy *energies[ENERGIES];
    const int n_energies = hg_hair_energies(energies);
    const int fixed = (int)(sizeof rows / sizeof *rows);
    const int most = fixed + n_energies * (5 + 2 * HG_ENERGY_PARAMS + HG_ENERGY_OPTIONS);
    schema *made = hg_alloc(1, sizeof *made);
    if (!made) return NULL;
    made->rows = hg_alloc((size_t)most, sizeof *made->rows);
    if (!made->rows) {
        hg_free(made);
        return NULL;
    }
    memcpy(made->rows, rows, sizeof rows);
    made->n = fixed;
    made->energies = n_energies;
    for (int i = 0; i < n_energies; i++) made->n += energy_rows(energies[i], made->rows + made->n);
    for (int i = 0; i < made->n; i++)
        if (!made->rows[i].key) made->n = i; /* out of memory: the keys from here on are unknown, and said to be */
    return made;
}

const hg_config_row *hg_hair_schema(int *n)
{
    pthread_mutex_lock(&lock);
    const int energies = hg_list("energy", NULL, 0);
    if (!newest || newest->energies != energies) {
        schema *made = schema_make();
        if (made) {
            made->older = newest;
            newest = made;
        }
    }
    const schema *found = newest;
    pthread_mutex_unlock(&lock);
    *n = found ? found->n : 0;
    return found ? found->rows : NULL;
}

/* Whether a list is the one that stands there when nothing is written; an echo of it is the same. */
bool hg_hair_is_usual_list(const hg_config *config, const char *key)
{
    int n, count = hg_config_count(config, key);
    const hg_config_row *schema_rows = hg_hair_schema(&n);
    hg_text text = { 0 };
    for (int i = 0; i < count; i++) hg_text_add(&text, "%s%s", i ? ", " : "[", hg_config_text_at(config, key, i));
    hg_text_add(&text, count ? "]" : "[]");
    bool usual = false;
    for (int i = 0; schema_rows && !text.failed && i < n; i++)
        usual |= strcmp(schema_rows[i].key, key) == 0 && schema_rows[i].value &&
                 strcmp(schema_rows[i].value, text.data) == 0;
    hg_text_free(&text);
    return usual;
}

hg_status hg_hair_config_loaded(hg_status status)
{
    if (status != HG_INVALID || !strstr(hg_message(), "unknown key \"losses.")) return status;
    char *sentence = hg_strdup(hg_message());
    if (!sentence) return HG_MEMORY;
    char *list = strstr(sentence, "; known here:"); /* a long list; `hairgrad losses` has it */
    if (list) *list = '\0';
    hg_fail(status,
            "%s; hairgrad losses lists the energies, one of a plug-in is known once --plugin FILE has loaded it",
            sentence);
    hg_free(sentence);
    return status;
}

hg_status hg_hair_config_load(hg_config **config, const char *path)
{
    int n;
    const hg_config_row *schema_rows = hg_hair_schema(&n);
    if (!schema_rows) return HG_MEMORY;
    return hg_hair_config_loaded(hg_config_load(config, path, schema_rows, n));
}

/* An echo writes the section of every energy that is on with its weight. One that is off stays out: a run does not depend on
 * energies, of a plug-in or of a later version, that it does not use. */
static hg_status copy_weights(hg_config *copy, const hg_config *config)
{
    const hg_energy *energies[ENERGIES];
    const int n = hg_hair_energies(energies);
    for (int i = 0; i < n; i++) {
        char section[160], key[176], value[32];
        snprintf(section, sizeof section, "losses.%s", energies[i]->name);
        snprintf(key, sizeof key, "%s.weight", section);
        double weight = hg_config_number(config, key);
        if (!hg_config_given(config, key)) weight = hg_config_given(config, section) ? 1 : 0;
        if (!hg_config_given(config, section) && weight == 0) continue;
        snprintf(value, sizeof value, "%.17g", weight);
        HG_TRY(hg_config_set(copy, key, value));
    }
    return HG_OK;
}

/* What a network predicts stays what it was trained with, whatever energies judge it later. */
static hg_status copy_orientations(hg_config *copy)
{
    if (strcmp(hg_config_text(copy, "model.orientations"), "asked")) return HG_OK;
    hg_hair_terms terms;
    hg_hair_asks asks;
    HG_TRY(hg_hair_terms_create(&terms, copy));
    HG_TRY(hg_hair_asks_of(&asks, &terms));
    return hg_config_set(copy, "model.orientations", asks.q ? "yes" : "no");
}

hg_status hg_hair_config_copy(hg_config **copy, const hg_config *config)
{
    *copy = NULL;
    int n;
    const hg_config_row *schema_rows = hg_hair_schema(&n);
    char *text = hg_config_echo(config);
    if (!schema_rows || !text) {
        hg_free(text);
        return HG_MEMORY;
    }
    hg_status status = hg_config_parse(copy, text, hg_config_name(config), schema_rows, n);
    hg_free(text);
    if (status == HG_OK) status = copy_weights(*copy, config);
    if (status == HG_OK) status = copy_orientations(*copy);
    if (status == HG_OK) hg_config_lines(*copy, config);
    if (status != HG_OK) {
        hg_config_destroy(*copy);
        *copy = NULL;
    }
    return status;
}

/* ---- terms -------------------------------------------------------------------------------------------------- */

hg_status hg_hair_terms_create(hg_hair_terms *terms, const hg_config *config)
{
    *terms = (hg_hair_terms){ 0 };
    const hg_energy *energies[ENERGIES];
    const int n = hg_hair_energies(energies);
    for (int i = 0; i < n; i++) {
        char key[160];
        snprintf(key, sizeof key, "losses.%s.weight", energies[i]->name);
        const double weight = hg_config_number(config, key);
        if (weight == 0) continue;
        if (terms->n == HG_HAIR_TERMS)
            return hg_fail(HG_INVALID, "%s: more than %d energies at once", hg_config_name(config), HG_HAIR_TERMS);
        double *params = terms->params[terms->n];
        const char **options = terms->options[terms->n];
        for (int k = 0; k < HG_ENERGY_PARAMS && energies[i]->params[k].name; k++) {
            snprintf(key, sizeof key, "losses.%s.%s", energies[i]->name, energies[i]->params[k].name);
            params[k] = hg_config_number(config, key);
        }
        for (int k = 0; k < HG_ENERGY_OPTIONS && energies[i]->options[k].name; k++) {
            snprintf(key, sizeof key, "losses.%s.%s", energies[i]->name, energies[i]->options[k].name);
            options[k] = hg_config_text(config, key);
        }
        terms->term[terms->n++] =
            (hg_term){ .energy = energies[i], .weight = weight, .params = params, .options = options };
    }
    if (terms->n == 0)
        return hg_fail(HG_INVALID,
                       "%s: no energy under `losses:`; a hair needs at least stretch, bend_twist and gravity",
                       hg_config_name(config));
    return HG_OK;
}
