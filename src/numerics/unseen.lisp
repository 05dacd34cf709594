;;; anmech: what acts for a shorter time than steps take, and so may have been stepped over.
;;;
;;; Two integrations agree if both step over a pulse.  Where the field depends on time, it is looked at in long steps,
;;; at one and the same state: at equidistant times, and on both sides of breakpoints at distances that are halved, for
;;; who tells of a pulse may tell its middle.  Where the field is rough there, seen at this spacing or at wider ones,
;;; the motion that was found is put into the equations; where the rates are others than those of the motion, something
;;; was not seen, and it is integrated again with steps that end there.  What was not seen counts in units of the sizes
;;; that the states have had until then, as errors do: those of a motion that grows are larger later; it may be a third
;;; of the error that is told, as errors may grow afterwards.  Of stiff equations small errors make large rates, which
;;; decay at once.  A pulse between two of the equidistant times is not found: who knows of one says so by breakpoints
;;; or the longest step.
;;;
;;; Entry points: UNSEEN-TIMES, *LOOKS-FOR-PULSES*.
;;;
;;; Literature: W. H. Enright, A new error-control for initial value solvers, Appl. Math. Comput. 31 (1989) 288 (the
;;; defect).

(in-package :anmech)
(needs "arithmetic/floats" "numerics/integration" "numerics/weights")

(defparameter *looks-for-pulses* 2000 "At how many times, if all steps are long.")
(defparameter *most-unseen* 200 "How many times are handed out.")

(defparameter *least-unseen* 3d-11 "What is looked for, in proportion to the states, however small the error is.")
(defparameter *nearest-look* 1d-6 "How near to a breakpoint, in units of the time between two looks.")

(defun unseen-times (problem integration error)
  "Times at which INTEGRATION, which is said to err by ERROR, does not follow the equations, and their neighbours."
  (let* ((start (integration-start integration)) (end (integration-time integration))
         (spacing (/ (- (problem-end problem) start) *looks-for-pulses*)) (found '()) (sizes nil)
         (state (zeros (problem-n problem))) (least (/ (max error *least-unseen*) 3)) (matter nil))
    (unless (= start end)
      (setq sizes (least-along problem integration nil))
      (dotimes (place (step-count integration))
        (raise-sizes sizes (state-of-step integration place state) 0 1 1d0)
        (setq matter (map-doubles ((size sizes)) (flo (* (flo (* 0.3d0 least)) size))))
        (loop for (time-at . rough) in (append (rows-of-looks problem integration place spacing matter)
                                               (rows-at-ends problem integration place spacing matter))
              when rough
                do (dolist (k (looks-at-defects problem integration place time-at rough sizes least))
                     (loop for near from (1- k) to (1+ k)
                           do (pushnew (funcall time-at near) found))))      ; that of two neighbours is the same double
        (when (> (length found) *most-unseen*) (return))))
    found))

(defun looks-at-defects (problem integration place time-at looks sizes least)
  "Those of the LOOKS, numbers of which the function TIME-AT gives the times, in the step at PLACE, at which the rates
of the motion are not those of the field, if that has changed one of the states by more than the part LEAST of its size,
which has been that of SIZES: what lasts for longer than the time between two looks adds up.  Those where the defect is
a small one beside others are not among them."
  (declare (type function time-at) (type double-array sizes))
  (let* ((n (problem-n problem)) (sum (zeros n)) (point (copy-seq (problem-start problem)))
         (counts nil) (largest 0d0) (found '()))
    (declare (type double-array sum point) (double-float largest))
    (dolist (look looks)
      (let* ((between (abs (* 0.5d0 (- (the double-float (funcall time-at (1+ look)))
                                       (the double-float (funcall time-at (1- look)))))))
             (defects (defects-at problem integration place (funcall time-at look) between point)) (part 0d0))
        (declare (double-float between part))
        (when defects
          (dotimes (i n)
            (let ((defect (aref (the double-array defects) i))
                  (size (max (aref sizes i) (abs (aref point i)) least-positive-normalized-double-float)))
              (declare (double-float defect size))
              (incf (aref sum i) (* between defect))
              (when (> (abs (aref sum i)) (* least size)) (setq counts t))
              (setq part (max part (/ (abs defect) size)))))
          (setq largest (max largest part))
          (push (cons look part) found))))
    (when counts
      (loop for (look . part) in found
            when (> (the double-float part) (* 1d-1 largest)) collect look))))

(defun rows-of-looks (problem integration place spacing matter)
  "If the step at PLACE is a long one, for SPACING, and for two, four .. times it, as long as many are in the step:
pairs of a function that gives the times of looks from their numbers, and the numbers of those about which the field is
rough as a function of time alone, so that it may matter: by rates that bring MATTER from one look to the next.  Seen at
the narrowest spacing, what is wide is smooth."
  (when (> (abs (step-length integration place)) (* 5 (abs spacing)))   ; a shorter one has looked as closely itself
    (let* ((start (integration-start integration)) (length (step-length integration place)) (n (problem-n problem))
           (way (- (aref (the double-array (integration-times integration)) place) start))
           (first (ceiling (+ (/ way spacing) *aside*)))
           (count (1+ (- (floor (- (/ (+ way length) spacing) *aside*)) first)))
           (values (rates-at-times problem integration place (lambda (k) (+ start (* (+ first k) spacing))) count)))
      (loop for stride = 1 then (* 2 stride)
            for looks = (ceiling count stride)
            while (or (= stride 1) (>= looks *looks-in-row*))
            collect (let* ((stride stride) (between (* stride (abs spacing))))
                      (declare (double-float between))
                      (cons (lambda (k) (+ start (* (+ first (* k stride)) spacing)))
                            (rough-places values n stride looks
                                          (map-doubles ((small matter)) (flo (/ small between)))
                                          (/ (time-noise start way length) between))))))))

(defun time-noise (start way length)
  "What a sixth difference may hold of how times are rounded in the step of that LENGTH, so far on the WAY from START:
as a time, in which rates change."
  (* 128d0 (spacing-at (max (abs (+ start way)) (abs (+ start way length))))))

(defparameter *rounding-of-field* 1d-11 "Smaller differences, in proportion to the rates, are none.")
(defparameter *aside* 1d-3 "So far from the ends of a step, in units of their distance, for the field may jump there.")
(defparameter *looks-in-row* 16 "The fewest of a row of wider spacing.")

(defun rates-at-times (problem integration place time-at count)
  "The rates of the field at the times that the function TIME-AT gives for the numbers from 0 below COUNT, one after the
other, in the state where the step at PLACE begins."
  (declare (type function time-at) (fixnum count))
  (let* ((n (problem-n problem)) (field (field-where-it-is (problem-field problem)))
         (point (copy-seq (problem-start problem))) (rates (zeros n)) (values (zeros (max 0 (* n count)))))
    (declare (type double-array point rates values) (type function field) (fixnum n))
    (state-of-step integration place point)
    (dotimes (k count values)
      (setf (aref point n) (funcall time-at k))
      (funcall field point rates)
      (replace values rates :start1 (the fixnum (* k n))))))

(defun rows-at-ends (problem integration place spacing matter)
  "The same on the inner side of each end of the step at PLACE that is a breakpoint, or an end of the motion: the
distances of looks from it are halved.  Not where steps are as short as those that lead over what was found."
  (let ((times (integration-times integration)) (length (step-length integration place)))
    (declare (type double-array times))
    (when (> (abs length) (* 1.5d0 (abs spacing)))
      (loop for (time distance) in (list (list (aref times place) (* 0.25d0 length))
                                         (list (aref times (1+ place)) (* -0.25d0 length)))
            when (or (= time (integration-start integration)) (= time (integration-time integration))
                     (member time (problem-breakpoints problem) :test #'=))
              collect (let* ((time time) (distance distance) (part (abs distance))
                             (time-at (lambda (k) (+ time (* distance (expt 0.5d0 k)))))
                             (nearest (max (* *nearest-look* (abs spacing)) (* 1d-13 (abs time))))
                             (count (floor (log (/ part nearest) 2))))
                        (declare (double-float part))
                        (cons time-at
                              (rough-approach (rates-at-times problem integration place time-at count)
                                              (problem-n problem) count
                                              (map-doubles ((small matter)) (flo (/ small part)))
                                              (/ (time-noise time 0d0 distance) part))))))))

(defun rough-approach (values n count least noise)
  "Of COUNT looks at distances that are halved, where the field has had VALUES, those down to which it is not smooth:
what is extrapolated from five of them would change by a thirtieth of what it has changed before; and by more than the
part NOISE of what changes from the first look to the second."
  (declare (type double-array values least) (fixnum n count) (double-float noise))
  (let ((rough nil) (row (zeros (max 0 count))))
    (declare (type double-array row))
    (dotimes (i n)
      (let ((largest 0d0) (before 1d300) (rounding 0d0))
        (declare (double-float largest before rounding))
        (dotimes (k count)
          (setf (aref row k) (aref values (the fixnum (+ i (the fixnum (* k n))))))
          (setq largest (max largest (abs (aref row k)))))
        (setq rounding (max (* *rounding-of-field* largest)
                            (if (> count 1) (* 2d0 noise (abs (- (aref row 1) (aref row 0)))) 0d0)))
        (loop for factor of-type double-float in '(2d0 4d0 8d0 16d0)
              for last of-type fixnum downfrom (1- count)
              do (dotimes (k last)
                   (setf (aref row k) (/ (- (* factor (aref row (1+ k))) (aref row k)) (- factor 1d0)))))
        (dotimes (k (- count 5))
          (let ((change (abs (- (aref row (1+ k)) (aref row k)))))
            (when (> change (max (aref least i) rounding (* 0.5d0 before)))
              (setq rough (max (or rough 0) (+ k 5))))
            (setq before change)))))
    (and rough (loop for k from 0 to rough collect k))))

(defun field-where-it-is (field)
  "FIELD, with 0 for rates that have no value, or one that is too large for a double: elsewhere a pulse is still seen."
  (declare (type function field))
  (lambda (point rates)
    (handler-case (funcall field point rates)
      ((or domain-violation arithmetic-error) () (fill (the double-array rates) 0d0)))))

(defun rough-places (values n stride count least noise)
  "The numbers from 0 below COUNT of looks, every STRIDEth of those where the field has had VALUES, about which it is
rough: its sixth differences are no small ones beside the fourth, or all at once much larger than they have been, for a
pulse may be small beside the rates and their changes, and rounding is smaller still; but where times are late it is the
part NOISE of what changes from one look to the next."
  (declare (type double-array values least) (fixnum n stride count) (double-float noise))
  (let ((rounding *rounding-of-field*) (found '()) (step (* n stride)))
    (declare (fixnum step) (double-float rounding))
    (dotimes (i n)
      (let ((largest 0d0) (turned 0d0)
            (fourth-differences 0d0)                    ; the largest, those longer ago less and less
            (recent 0d0) (before 1d300) (calm 1d300))   ; the largest sixth differences until some looks ago
        (declare (double-float largest turned fourth-differences recent before calm))
        (with-fast-arithmetic
          (for (k count)
            (let ((last (fix (+ i (fix (* k step))))))
              (declare (fixnum last))
              (setq largest (flo (max largest (abs (aref values last)))))
              (when (> k 0)
                (setq turned (flo (max (* 0.8d0 turned)
                                       (abs (- (aref values last) (aref values (fix (- last step)))))))))
              (when (and (>= k 10) (zerop (logand k 3)))
                (setq calm before
                      before recent))
              (when (>= k 6)
                (let* ((a (aref values (fix (- last (* 6 step))))) (b (aref values (fix (- last (* 5 step)))))
                       (c (aref values (fix (- last (* 4 step))))) (d (aref values (fix (- last (* 3 step)))))
                       (e (aref values (fix (- last (* 2 step))))) (f (aref values (fix (- last step))))
                       (g (aref values last))
                       (first (flo (- (+ (+ a e) (* 6d0 c)) (* 4d0 (+ b d)))))
                       (second (flo (- (+ (+ b f) (* 6d0 d)) (* 4d0 (+ c e)))))
                       (third (flo (- (+ (+ c g) (* 6d0 e)) (* 4d0 (+ d f)))))
                       (sixth-difference (flo (abs (- (+ first third) (* 2d0 second))))))
                  (declare (double-float a b c d e f g first second third sixth-difference))
                  (setq fourth-differences (flo (max (* 0.8d0 fourth-differences)
                                                     (max (abs first) (max (abs second) (abs third))))))
                  (when (and (> sixth-difference
                                (flo (max (aref least i) (max (* rounding largest) (* noise turned)))))
                             (or (> sixth-difference (flo (* 0.25d0 fourth-differences)))
                                 (> sixth-difference (flo (* 30d0 calm)))))
                    (for (back 7) (pushnew (fix (- k back)) found)))
                  (setq recent (flo (max recent sixth-difference))))))))))
    (sort found #'<)))

(defun defects-at (problem integration place time spacing point)
  "By what the rates of the field differ at TIME from those of the motion, in the step at PLACE, the state of which is
written to POINT; nil where one of them has no value, or at the ends of the step and beyond."
  (handler-case (defects-there problem integration place time spacing point)
    ((or domain-violation arithmetic-error) () nil)))

(defun defects-there (problem integration place time spacing point)
  "The same, if all that it takes has values."
  (declare (double-float time) (type double-array point))
  (let* ((n (problem-n problem)) (kept (kept-of-step integration place))
         (before (zeros n)) (after (zeros n)) (rates (zeros n)) (value (integration-interpolant integration))
         (begin (aref (the double-array (integration-times integration)) place))
         (length (step-length integration place))
         (inside (min (* (signum length) (- time begin)) (* (signum length) (- (+ begin length) time))))
         (width (min (* 1d-4 (abs length)) (* 0.25d0 inside))))
    (declare (type function value) (double-float begin length inside width))
    (when (> width (* 1d-15 (abs time)))
      (funcall value kept (- time width) before n)
      (funcall value kept (+ time width) after n)
      (funcall value kept time point n)
      (setf (aref point n) time)
      (funcall (the function (problem-field problem)) point rates)
      (held-back problem point rates spacing
                 (map-doubles ((rate rates) (earlier before) (later after))
                   (flo (- rate (/ (- later earlier) (* 2d0 width)))))))))

(defun held-back (problem point rates spacing defects)
  "What DEFECTS of the RATES at POINT come to for as long as SPACING, if the rates that they change themselves hold them
back: of stiff equations small errors of states make large rates."
  (let* ((n (problem-n problem)) (other (copy-seq point)) (changed (zeros n)) (spacing (abs spacing))
         (part 1d-1))
    (declare (type double-array other) (double-float spacing part))
    (dotimes (i n)
      (incf (aref other i) (* part spacing (the double-float (aref (the double-array defects) i)))))
    (funcall (the function (problem-field problem)) other changed)
    (map-doubles ((defect defects) (rate rates) (new changed))
      (flo (/ defect (+ 1d0 (/ (abs (- new rate)) (* part (max (abs defect) 1d-200)))))))))
