// The world around the card, clock by clock: drives the pins of the Verilated gateware and collects what it sends.
//
// Compiled together with Verilator's output into a shared library; `sim/core.py` is its only caller and holds the
// documentation of each call. One clock is: inputs change, combinational logic settles, rising edge.

#include <cstdint>
#include <cstring>
#include <deque>
#include <vector>

#include "Vtop.h"
#include "verilated.h"

namespace {

struct Pin {  // a pin takes a level at a time
    uint64_t clock;
    uint32_t pin;
    uint32_t level;
};

struct Row {
    uint64_t clock;  // of column 0
    std::vector<uint8_t> rgb;
    bool frame_first;
};

class ByteClock {  // lets one byte pass every so many clocks, on average exactly
   public:
    void rate(double bytes_per_clock) { step_ = static_cast<uint64_t>(bytes_per_clock * one); }
    void tick() { credit_ = credit_ + step_ < one ? credit_ + step_ : one; }
    bool ready() const { return credit_ >= one; }
    void take() { credit_ -= one; }

   private:
    static constexpr uint64_t one = 1ull << 40;
    uint64_t step_ = one, credit_ = one;
};

class Card {
   public:
    Card() : context_(new VerilatedContext), top_(new Vtop(context_)) {}
    ~Card() {
        top_->final();
        delete top_;
        delete context_;
    }

    void start(uint32_t clock_hz, double bytes_per_clock, uint64_t serial) {
        top_->clock_hz = clock_hz;
        top_->serial = serial;
        in_clock_.rate(bytes_per_clock);
        out_clock_.rate(bytes_per_clock);
    }

    void run(uint64_t until) {
        for (; now_ < until; now_++) {
            while (!pins_.empty() && pins_.front().clock <= now_) {
                set(pins_.front().pin, pins_.front().level);
                pins_.pop_front();
            }
            drive_video();
            in_clock_.tick();
            out_clock_.tick();
            top_->rx_valid = !in_.empty() && in_clock_.ready();
            if (top_->rx_valid) top_->rx_data = in_.front();
            top_->tx_ready = out_.size() < out_limit_ && out_clock_.ready();
            top_->clk = 0;
            top_->eval();
            if (top_->rx_valid && top_->rx_ready) {
                in_.pop_front();
                in_clock_.take();
            }
            if (top_->tx_ready && top_->tx_valid) {
                out_.push_back(top_->tx_data);
                out_clock_.take();
            }
            drive_ += top_->brake ? 0 : top_->pwm ? (top_->direction ? -1 : 1) : 0;
            braked_ += top_->brake;
            lit_ += top_->laser;
            measured_++;
            top_->clk = 1;
            top_->eval();
        }
    }

    void set(uint32_t pin, uint32_t level) {
        switch (pin) {
            case 0: top_->encoder_a = level; break;
            case 1: top_->encoder_b = level; break;
            case 2: top_->index = level; break;
            case 3: top_->interlock = level; break;
        }
    }

    void drive_video() {
        top_->video_frame_end = 0;
        if (at_ < pixels_.size()) {
            drive_pixel();
        } else if (!rows_.empty() && rows_.front().clock <= now_) {
            pixels_.swap(rows_.front().rgb);
            frame_first_ = rows_.front().frame_first;
            rows_.pop_front();
            at_ = 0;
            drive_pixel();
        } else {
            top_->video_valid = 0;
            if (!ends_.empty() && ends_.front() <= now_) {
                top_->video_frame_end = 1;
                ends_.pop_front();
            }
        }
    }

    void drive_pixel() {
        top_->video_valid = 1;
        top_->video_r = pixels_[at_];
        top_->video_g = pixels_[at_ + 1];
        top_->video_b = pixels_[at_ + 2];
        top_->video_row_first = at_ == 0;
        top_->video_frame_first = at_ == 0 && frame_first_;
        at_ += 3;
        top_->video_row_last = at_ == pixels_.size();
    }

    VerilatedContext* context_;
    Vtop* top_;
    uint64_t now_ = 0;
    std::deque<Pin> pins_;
    std::deque<Row> rows_;
    std::deque<uint64_t> ends_;
    std::vector<uint8_t> pixels_;
    size_t at_ = 0;
    bool frame_first_ = false;
    std::deque<uint8_t> in_, out_;
    size_t out_limit_ = 4096;
    ByteClock in_clock_, out_clock_;
    int64_t drive_ = 0;
    uint64_t braked_ = 0, lit_ = 0, measured_ = 0;
};

}  // namespace

extern "C" {

struct Outputs {
    uint64_t clock;
    double drive;   // mean of the signed PWM since the last call, -1 to 1
    double braked;  // part of the time that the brake was on
    double lit;     // part of the time that the laser was on
    uint8_t laser, lamp, run;
};

Card* card_new(uint32_t clock_hz, double bytes_per_clock, uint64_t serial) {
    Card* card = new Card;
    card->start(clock_hz, bytes_per_clock, serial);
    return card;
}

void card_delete(Card* card) { delete card; }

void card_pins(Card* card, const Pin* pins, size_t count) { card->pins_.insert(card->pins_.end(), pins, pins + count); }

void card_row(Card* card, uint64_t clock, const uint8_t* rgb, size_t columns, int frame_first) {
    card->rows_.push_back({clock, std::vector<uint8_t>(rgb, rgb + 3 * columns), frame_first != 0});
}

void card_frame_end(Card* card, uint64_t clock) { card->ends_.push_back(clock); }

void card_send(Card* card, const uint8_t* data, size_t count) { card->in_.insert(card->in_.end(), data, data + count); }

size_t card_receive(Card* card, uint8_t* data, size_t room) {
    size_t count = room < card->out_.size() ? room : card->out_.size();
    std::copy_n(card->out_.begin(), count, data);
    card->out_.erase(card->out_.begin(), card->out_.begin() + count);
    return count;
}

size_t card_waiting(Card* card) { return card->in_.size(); }

void card_run(Card* card, uint64_t until, Outputs* outputs) {
    card->run(until);
    double clocks = card->measured_ ? static_cast<double>(card->measured_) : 1.0;
    *outputs = {card->now_, card->drive_ / clocks, card->braked_ / clocks, card->lit_ / clocks,
                card->top_->laser, card->top_->lamp, card->top_->run};
    card->drive_ = 0;
    card->braked_ = card->lit_ = card->measured_ = 0;
}
}
