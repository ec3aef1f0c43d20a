/* metrics_file: metrics of several clips, their mean, and both as JSON; those of a solve. */
#include "tasks/json.h"

#include <math.h>

void hg_hair_metrics_mean(const hg_hair_metrics *metrics, int n, hg_hair_metrics *mean)
{
    *mean = (hg_hair_metrics){ .tip_lag = (double)NAN };
    double frames = 0, lag = 0, lag_frames = 0;
    for (int i = 0; i < n; i++) frames += (double)metrics[i].frames;
    for (int i = 0; i < n; i++) {
        const hg_hair_metrics *m = &metrics[i];
        const double share = frames > 0 ? (double)m->frames / frames : 0;
        mean->frames += m->frames;
        mean->strands = m->strands;
        mean->length_error += share * m->length_error;
        mean->orientation += share * m->orientation;
        mean->inside += share * m->inside;
        mean->inside_posed += share * m->inside_posed;
        mean->energy += share * m->energy;
        mean->energy_posed += share * m->energy_posed;
        mean->gravity_body += share * m->gravity_body;
        mean->gravity_body_posed += share * m->gravity_body_posed;
        mean->curl += share * m->curl;
        mean->tip_moved += share * m->tip_moved;
        mean->tip_amplitude += share * m->tip_amplitude;
        mean->n_terms = m->n_terms;
        for (int k = 0; k < m->n_terms; k++) {
            mean->term[k] = m->term[k];
            mean->term_energy[k] += share * m->term_energy[k];
            mean->term_posed[k] += share * m->term_posed[k];
        }
        if (isfinite(m->tip_lag)) lag += (double)m->frames * m->tip_lag, lag_frames += (double)m->frames;
    }
    if (lag_frames > 0) mean->tip_lag = lag / lag_frames;
}

void hg_hair_json_number(hg_text *text, const char *indent, const char *name, double value, const char *end)
{
    if (isfinite(value))
        hg_text_add(text, "%s\"%s\": %.6g%s\n", indent, name, value, end);
    else
        hg_text_add(text, "%s\"%s\": null%s\n", indent, name, end);
}

void hg_hair_json_text(hg_text *text, const char *words)
{
    hg_text_add(text, "\"");
    for (const char *c = words; *c; c++)
        if ((unsigned char)*c >= 0x20) hg_text_add(text, *c == '"' || *c == '\\' ? "\\%c" : "%c", *c);
    hg_text_add(text, "\"");
}

static void one(hg_text *text, const char *in, const hg_hair_metrics *m)
{
    hg_hair_json_number(text, in, "frames", (double)m->frames, ",");
    hg_hair_json_number(text, in, "strands", (double)m->strands, ",");
    hg_hair_json_number(text, in, "length_error_percent", m->length_error, ",");
    hg_hair_json_number(text, in, "orientation_degrees", m->orientation, ",");
    hg_hair_json_number(text, in, "inside_percent", m->inside, ",");
    hg_hair_json_number(text, in, "inside_posed_percent", m->inside_posed, ",");
    hg_hair_json_number(text, in, "energy_joule_per_strand", m->energy, ",");
    hg_hair_json_number(text, in, "energy_posed_joule_per_strand", m->energy_posed, ",");
    hg_hair_json_number(text, in, "gravity_body_joule_per_strand", m->gravity_body, ",");
    hg_hair_json_number(text, in, "gravity_body_posed_joule_per_strand", m->gravity_body_posed, ",");
    hg_hair_json_number(text, in, "curl_of_rest", m->curl, ",");
    hg_hair_json_number(text, in, "tip_moved_percent_of_length", m->tip_moved, ",");
    hg_hair_json_number(text, in, "tip_speed_metres_per_second", m->tip_amplitude, ",");
    hg_hair_json_number(text, in, "tip_lag_seconds", m->tip_lag, ",");
    hg_text_add(text, "%s\"terms\": {\n", in);
    for (int k = 0; k < m->n_terms; k++) {
        hg_text_add(text, "%s  \"%s\": { \"energy\": %.6g, \"posed\": %.6g }%s\n", in, m->term[k], m->term_energy[k],
                    m->term_posed[k], k + 1 < m->n_terms ? "," : "");
    }
    hg_text_add(text, "%s}\n", in);
}

hg_status hg_hair_metrics_write(const char *path, int n, const char *const *clips, const hg_hair_metrics *metrics)
{
    hg_text text = { 0 };
    hg_text_add(&text, "{\n  \"clips\": [\n");
    for (int i = 0; i < n; i++) {
        hg_text_add(&text, "    {\n      \"clip\": ");
        hg_hair_json_text(&text, clips[i]);
        hg_text_add(&text, ",\n");
        one(&text, "      ", &metrics[i]);
        hg_text_add(&text, "    }%s\n", i + 1 < n ? "," : "");
    }
    hg_hair_metrics mean;
    hg_hair_metrics_mean(metrics, n, &mean);
    hg_text_add(&text, "  ],\n  \"mean\": {\n");
    one(&text, "    ", &mean);
    hg_text_add(&text, "  }\n}\n");
    const hg_status status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}

hg_status hg_hair_solution_write(const char *path, const char *clip, const hg_hair_solution *solution)
{
    hg_text text = { 0 };
    hg_text_add(&text, "{\n  \"clip\": ");
    hg_hair_json_text(&text, clip);
    hg_text_add(&text, ",\n");
    hg_hair_json_number(&text, "  ", "solves", (double)solution->solves, ",");
    hg_hair_json_number(&text, "  ", "converged", (double)solution->converged, ",");
    hg_hair_json_number(&text, "  ", "stalled", (double)solution->stalled, ",");
    hg_hair_json_number(&text, "  ", "evaluations", (double)solution->evaluations, ",");
    hg_hair_json_number(&text, "  ", "iterations_per_strand", solution->iterations, ",");
    hg_hair_json_number(&text, "  ", "seconds", solution->seconds, ",");
    hg_hair_json_number(&text, "  ", "largest_force_newton", solution->force, ",");
    hg_hair_json_number(&text, "  ", "largest_movement_metres", solution->movement, ",");
    hg_text_add(&text, "  \"left_out\": ");
    hg_hair_json_text(&text, solution->left_out);
    hg_text_add(&text, ",\n  \"minimum\": {\n");
    one(&text, "    ", &solution->metrics);
    hg_text_add(&text, "  }\n}\n");
    const hg_status status = text.failed ? HG_MEMORY : hg_file_write(path, text.data, text.size);
    hg_text_free(&text);
    return status;
}
