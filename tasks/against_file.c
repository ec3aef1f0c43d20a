/* against_file: comparisons of several clips: their mean, and both as JSON. */
#include "tasks/json.h"
#include "tasks/judge.h"

#include <math.h>
#include <stdio.h>

static void add_part(hg_against_part *sum, const hg_against_part *part, int n_terms, double share)
{
    sum->seconds += share * part->seconds;
    sum->length_error += share * part->length_error;
    sum->orientation += share * part->orientation;
    sum->curl += share * part->curl;
    sum->inside += share * part->inside;
    sum->distance += share * part->distance;
    sum->distance_p95 += share * part->distance_p95;
    sum->energy += share * part->energy;
    for (int i = 0; i < n_terms; i++) sum->term_energy[i] += share * part->term_energy[i];
    sum->excess += share * part->excess;
    sum->excess_free += share * part->excess_free;
    sum->excess_median += share * part->excess_median;
    sum->excess_free_median += share * part->excess_free_median;
    sum->solves += part->solves;
    sum->converged += part->converged;
    sum->stalled += part->stalled;
}

void hg_hair_against_mean(const hg_against *against, int n, hg_against *mean)
{
    *mean = (hg_against){ 0 };
    if (n < 1) return;
    *mean = against[0];
    mean->tip = NULL;
    mean->n_tips = 0;
    mean->poses = mean->frames = 0;
    for (int i = 0; i < n; i++) mean->poses += against[i].poses, mean->frames += against[i].frames;
    for (int k = 0; k < mean->n_sides; k++) {
        hg_against_side *side = &mean->side[k];
        double lag_frames = 0;
        *side = (hg_against_side){ .name = side->name };
        for (int i = 0; i < n; i++) {
            const hg_against_side *of = &against[i].side[k];
            const double share = mean->frames > 0 ? (double)against[i].frames / (double)mean->frames : 0;
            add_part(&side->rest, &of->rest, mean->n_terms, (double)against[i].poses / (double)mean->poses);
            if (!(share > 0)) continue;
            add_part(&side->motion, &of->motion, mean->n_terms, share);
            side->tips.speed += share * of->tips.speed * of->tips.speed;
            side->tips.excursion += share * of->tips.excursion * of->tips.excursion;
            side->tips.correlation += share * of->tips.correlation;
            if (!isfinite(of->tips.lag)) continue;
            side->tips.lag += share * of->tips.lag;
            lag_frames += share;
        }
        side->tips.speed = sqrt(side->tips.speed);
        side->tips.excursion = sqrt(side->tips.excursion);
        side->tips.lag = lag_frames > 0 ? side->tips.lag / lag_frames : (double)NAN;
    }
    hg_hair_against_gaps(mean);
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static void write_part(hg_text *text, const char *in, const hg_against *a, const hg_against_part *part, bool moving)
{
    hg_hair_json_number(text, in, "seconds_per_frame", part->seconds, ",");
    hg_hair_json_number(text, in, "inside_percent", part->inside, ",");
    hg_hair_json_number(text, in, "length_error_percent", part->length_error, ",");
    hg_hair_json_number(text, in, "orientation_degrees", part->orientation, ",");
    hg_hair_json_number(text, in, "curl_of_rest", part->curl, ",");
    hg_hair_json_number(text, in, "distance_metres", part->distance, ",");
    hg_hair_json_number(text, in, "distance_p95_metres", part->distance_p95, ",");
    hg_hair_json_number(text, in, "gap", part->gap, ",");
    hg_hair_json_number(text, in, "gap_of_median_strand", part->gap_median, ",");
    hg_hair_json_number(text, in, "gap_without_contact", part->gap_free, ",");
    hg_hair_json_number(text, in, "gap_with_contact_of_posed", part->gap_contact, ",");
    hg_hair_json_number(text, in, "excess_joule_per_strand", part->excess, ",");
    hg_hair_json_number(text, in, "excess_without_contact_joule_per_strand", part->excess_free, ",");
    hg_hair_json_number(text, in, "excess_median_joule_per_strand", part->excess_median, ",");
    hg_hair_json_number(text, in, "energy_joule_per_strand", part->energy, ",");
    hg_text_add(text, "%s\"terms_joule_per_strand\": {", in);
    for (int i = 0, n = 0; i < a->n_terms; i++)
        if (moving || !a->term_moves[i])
            hg_text_add(text, "%s \"%s\": %.6g", n++ ? "," : "", a->term[i], part->term_energy[i]);
    hg_text_add(text, " }");
    if (part->solves)
        hg_text_add(text, ",\n%s\"solves\": %lld,\n%s\"converged\": %lld,\n%s\"stalled\": %lld", in,
                    (long long)part->solves, in, (long long)part->converged, in, (long long)part->stalled);
}

static void write_side(hg_text *text, const char *in, const hg_against *a, int k)
{
    const hg_against_side *side = &a->side[k];
    char deeper[64], deepest[64];
    snprintf(deeper, sizeof deeper, "%.40s  ", in);
    snprintf(deepest, sizeof deepest, "%.40s    ", in);
    hg_text_add(text, "%s{\n%s\"name\": ", in, deeper);
    hg_hair_json_text(text, side->name);
    hg_text_add(text, ",\n%s\"rest\": {\n", deeper);
    write_part(text, deepest, a, &side->rest, false);
    hg_text_add(text, "\n%s}", deeper);
    if (a->frames) {
        const hg_against_tips *tips = &side->tips, *other = &a->side[a->reference].tips;
        hg_text_add(text, ",\n%s\"motion\": {\n", deeper);
        write_part(text, deepest, a, &side->motion, true);
        hg_text_add(text, ",\n");
        hg_hair_json_number(text, deepest, "tip_speed_metres_per_second", tips->speed, ",");
        hg_hair_json_number(text, deepest, "tip_speed_of_reference", tips->speed / other->speed, ",");
        hg_hair_json_number(text, deepest, "tip_excursion_metres", tips->excursion, ",");
        hg_hair_json_number(text, deepest, "tip_excursion_of_reference", tips->excursion / other->excursion, ",");
        hg_hair_json_number(text, deepest, "tip_correlation", tips->correlation, ",");
        hg_hair_json_number(text, deepest, "tip_lag_seconds", tips->lag, "");
        hg_text_add(text, "%s}", deeper);
    }
    hg_text_add(text, "\n%s}", in);
}

static void write_one(hg_text *text, const char *in, const hg_against *a)
{
    char deeper[64];
    snprintf(deeper, sizeof deeper, "%.40s  ", in);
    hg_hair_json_number(text, in, "strands", (double)a->strands, ",");
    hg_hair_json_number(text, in, "poses", (double)a->poses, ",");
    hg_hair_json_number(text, in, "frames", (double)a->frames, ",");
    hg_text_add(text, "%s\"reference\": ", in);
    hg_hair_json_text(text, a->side[a->reference].name);
    hg_text_add(text, ",\n%s\"sides\": [\n", in);
    for (int k = 0; k < a->n_sides; k++) {
        write_side(text, deeper, a, k);
        hg_text_add(text, "%s\n", k + 1 < a->n_sides ? "," : "");
    }
    hg_text_add(text, "%s]\n", in);
}

hg_status hg_hair_against_write(const char *path, int n, const char *const *clips, const hg_against *against)
{
    hg_text text = { 0 };
    hg_text_add(&text, "{\n  \"against\": {\n    \"clips\": [\n");
    for (int i = 0; i < n; i++) {
        hg_text_add(&text, "      {\n        \"clip\": ");
        hg_hair_json_text(&text, clips[i]);
        hg_text_add(&text, ",\n        \"first_frame\": %lld,\n", (long long)against[i].first);
        write_one(&text, "        ", &against[i]);
        hg_text_add(&text, "      }%s\n", i + 1 < n ? "," : "");
    }
    hg_against mean;
    hg_hair_against_mean(against, n, &mean);
    hg_text_add(&text, "    ],\n    \"mean\": {\n");
    write_one(&text, "      ", &mean);
    hg_text_add(&text, "    }\n  }\n}\n");
    const hg_status status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}
